"""The cut of each built-in garment: where it hangs, how wide it is, and where it ends.

Lengths are in metres for an adult of 1.75 m and grow with the body; places along arms are fractions (0 shoulder,
1 elbow, 2 wrist).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Neckline:
    """A neck hole; lengths for an adult of 1.75 m.

    Args:
        front: how far below the base of the neck it dips in front [m].
        back: the same at the back [m].
        spread: half its width at the shoulders, beyond half the neck [m].
    """

    front: float
    back: float
    spread: float


@dataclass(frozen=True)
class Bands:
    """Bands sewn along the borders of a cut, by name; `parts` finds them.

    Args:
        layers: of cloth.
        fabrics: names of `FABRICS`, for bands of another cloth than the rest.
        elastic: rest length along the border over that of the cloth.
        widths: of bands that differ from the default width [m].
    """

    layers: Mapping[str, int] = field(default_factory=dict, hash=False)
    fabrics: Mapping[str, str] = field(default_factory=dict, hash=False)
    elastic: Mapping[str, float] = field(default_factory=dict, hash=False)
    widths: Mapping[str, float] = field(default_factory=dict, hash=False)


@dataclass(frozen=True)
class Cut:
    """The cut of one garment; lengths for an adult of 1.75 m.

    Args:
        top: "shoulder" (it hangs from the shoulders) or "waist".
        hem: "crotch", "knee", "calf" or "ankle".
        fabric: that it wears unless a run names another, of `FABRICS`.
        hem_offset: how far above that height it ends [m].
        ease: slack of the torso part at chest (or waist), waist, hip and hem [m].
        taper: largest decrease of the radius per metre downwards, above and below the waist [m/m]; negative: it must
            flare.
        neckline: of a garment that hangs from the shoulders.
        sleeve: position along the arm where the sleeve ends (1 elbow, 2 wrist); 0 for none.
        sleeve_ease: slack at the shoulder and at the cuff [m].
        armhole_depth: how far below the armpit an armhole of a sleeveless garment reaches [m].
        strap: width of the part that lies on the shoulder of a sleeveless garment [m].
        front_gap: width of the opening in front [m]; 0 for none.
        legs: whether each leg has a tube of its own.
        loose: whether it hangs far from the nearest limb.
        bands: bands along its borders if it is cut flat.
    """

    top: str
    hem: str
    fabric: str
    hem_offset: float
    ease: tuple[float, float, float, float]
    taper: tuple[float, float]
    neckline: Neckline = Neckline(0.0, 0.0, 0.0)
    sleeve: float = 0.0
    sleeve_ease: tuple[float, float] = (0.0, 0.0)
    armhole_depth: float = 0.0
    strap: float = 0.0
    front_gap: float = 0.0
    legs: bool = False
    loose: bool = False
    bands: Bands = Bands()

    @property
    def pins(self) -> str:
        """Name of the pinned vertices, as `resolve_pins` takes it: a waistband, or the collar of an open front.

        An open front slides off shoulders that slope by 20 degrees, where closed cloth stays. Garments that are cut
        flat have elastic instead of such a waistband.
        """
        if self.top == "waist":
            return "waist"
        return "collar" if self.front_gap > 0.0 else "none"


CREW = Neckline(front=0.055, back=0.0, spread=0.028)
SCOOP = Neckline(front=0.115, back=0.05, spread=0.038)

HEMMED = Bands(layers={"hem": 2})

CUTS: dict[str, Cut] = {
    "tshirt": Cut(
        "shoulder", "crotch", "cotton-jersey", 0.03, (0.025, 0.030, 0.032, 0.034), taper=(0.08, 0.08),
        neckline=CREW, sleeve=0.62, sleeve_ease=(0.008, 0.026),
        bands=Bands(layers={"hem": 2, "cuff": 2}, fabrics={"collar": "rib"}, widths={"cuff": 0.02}),
    ),
    "tanktop": Cut(
        "shoulder", "crotch", "rib", 0.05, (0.014, 0.026, 0.030, 0.033), taper=(0.14, 0.14),
        neckline=SCOOP, armhole_depth=0.035, strap=0.045, bands=HEMMED,
    ),
    "longsleeve": Cut(
        "shoulder", "crotch", "interlock", 0.03, (0.022, 0.028, 0.031, 0.034), taper=(0.10, 0.10),
        neckline=CREW, sleeve=1.93, sleeve_ease=(0.008, 0.016),
        bands=Bands(
            fabrics={"collar": "rib", "cuff": "rib", "hem": "rib"}, elastic={"collar": 0.95, "cuff": 0.8},
            widths={"cuff": 0.05, "hem": 0.04},
        ),
    ),
    "dress": Cut(
        "shoulder", "calf", "viscose", 0.0, (0.014, 0.020, 0.035, 0.035), taper=(0.30, -0.20),
        neckline=SCOOP, armhole_depth=0.03, strap=0.055, loose=True, bands=HEMMED,
    ),
    "fitted_dress": Cut(
        "shoulder", "knee", "ponte", 0.08, (0.010, 0.012, 0.016, 0.034), taper=(0.90, 0.08),
        neckline=Neckline(0.085, 0.02, 0.034), sleeve=0.40, sleeve_ease=(0.007, 0.014), loose=True,
        bands=Bands(layers={"hem": 2, "cuff": 2}, widths={"cuff": 0.02}),
    ),
    "cardigan": Cut(
        "shoulder", "crotch", "wool-knit", 0.02, (0.032, 0.036, 0.038, 0.040), taper=(0.06, 0.06),
        neckline=Neckline(0.075, 0.0, 0.030), sleeve=1.93, sleeve_ease=(0.011, 0.022), front_gap=0.08,
        bands=Bands(
            fabrics={"collar": "rib", "cuff": "rib", "hem": "rib"}, elastic={"cuff": 0.8},
            widths={"cuff": 0.06, "hem": 0.05},
        ),
    ),
    "trousers": Cut(
        "waist", "ankle", "denim-11oz", 0.025, (0.007, 0.007, 0.016, 0.030), taper=(0.10, 0.10), legs=True,
        bands=Bands(layers={"hem": 2}, elastic={"waist": 0.72}),
    ),
    "skirt": Cut(
        "waist", "knee", "wool-suiting", 0.0, (0.007, 0.007, 0.020, 0.035), taper=(0.0, -0.26), loose=True,
        bands=Bands(layers={"hem": 2}, elastic={"waist": 0.75}),
    ),
}  # fmt: skip
