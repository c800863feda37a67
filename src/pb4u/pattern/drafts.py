"""Garments that are drafted from measures of a body, as a tailor does: a shirt, jeans and a circle dress.

Lengths are in metres; drawn is the left half. Rules are those of the basic blocks of textbooks of pattern cutting:
quarters of a girth with its ease, forks as shares of the hips, a sleeve whose cap is as long as its armhole.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np

from pb4u.errors import InputError, refuse_unknown
from pb4u.pattern.draft import FOLD, Draft, Edge, Point, arc
from pb4u.pattern.pattern import FALL, Pattern

Measures: TypeAlias = Mapping[str, float]

_LEVELS = (
    "ankle_height", "knee_height", "crotch_height", "hip_height", "low_waist_height", "waist_height", "bust_height",
    "armpit_height", "shoulder_height", "neck_height",
)  # fmt: skip

MEASURES = (
    *_LEVELS, "neck_width", "shoulder_width", "bust", "bust_points", "front_length", "waist", "low_waist", "hips",
    "upper_arm", "wrist", "arm_length", "arm_angle", "thigh", "knee", "calf",
)  # fmt: skip
"""Measures that patterns are drafted from: heights above the floor from low to high, then widths and girths."""


def drafted(name: str, measures: Measures) -> Pattern:
    """A pattern drafted from measures of a body.

    Args:
        name: one of `DRAFTS`.
        measures: from `tailors_measures` [m; angles rad].

    Raises:
        InputError: there is no such pattern, or a measure is missing, no number above 0, or out of proportion.
    """
    refuse_unknown("pattern", [name], DRAFTS)
    for measure in MEASURES:
        value = measures.get(measure)
        if not isinstance(value, int | float) or isinstance(value, bool) or not 0.0 < value < np.inf:
            raise InputError(
                f"{name} is drafted from the measure {measure}, a number above 0 in metres, not {value!r}."
            )
    for low, high in pairwise(_LEVELS):
        if measures[low] >= measures[high]:
            raise InputError(
                f"{name} cannot be drafted: {low} is {measures[low]:.3f} m high, and {high}, which must be higher, "
                f"{measures[high]:.3f} m."
            )
    try:
        return DRAFTS[name](measures)
    except InputError as error:
        raise InputError(f"{name} cannot be drafted: no body has all of these measures ({error})") from None


def shirt(m: Measures) -> Pattern:
    """A shirt: front with a placket, back, sleeves with cuffs, a collar of stand and fall; buttoned, so it is closed.

    Args:
        m: measures from `tailors_measures`.
    """
    draft, quarter = Draft("shirt"), 0.25 * (m["bust"] + 0.14)
    placket, hem, tail = 0.016, m["crotch_height"] - 0.02, 0.06
    neck, shoulder = (0.5 * m["neck_width"] + 0.005, m["neck_height"]), _shoulder(m, 0.015)
    under, end = (quarter, m["armpit_height"] - 0.04), (max(quarter, 0.25 * (m["hips"] + 0.08)), hem + tail)
    throat, nape = (placket, neck[1] - neck[0] - 0.02), (0.0, neck[1] - 0.02)
    armhole = ((shoulder[0] - 0.01, 0.5 * (shoulder[1] + under[1])), (shoulder[0], under[1]))
    body = (("shoulder", neck), ("armhole", shoulder, *armhole), ("side", under))
    hem_curve = (0.6 * end[0], hem)
    draft.cut(
        "front", ("neck", throat, (0.6 * neck[0], throat[1]), (neck[0], throat[1] + 0.03)), *body,
        ("hem", end, hem_curve), ("placket", (placket, hem)), depth=0.15,
    )  # fmt: skip
    draft.cut(
        "placket", ("neck", (0.0, throat[1])), ("front", throat), ("hem", (placket, hem)), (FOLD, (0.0, hem)),
        depth=0.15,
    )  # fmt: skip
    draft.cut(
        "back", ("neck", nape, (0.7 * neck[0], nape[1])), *body, ("hem", end, hem_curve), (FOLD, (0.0, hem)),
        depth=-0.15,
    )  # fmt: skip
    draft.sew(*((f"front.{edge}", f"back.{edge}") for edge in ("shoulder", "side")), ("front.placket", "placket.front"))
    _sleeve(draft, m, shoulder)
    _collar(draft, neck, throat, nape)
    return draft.pattern()


def _sleeve(draft: Draft, m: Measures, shoulder: Point) -> None:
    """Sleeves in two halves, over and under the arm's side, gathered into cuffs."""
    cuff, half, wrist = 0.06, 0.5 * (m["upper_arm"] + 0.07), 0.5 * (m["wrist"] + 0.06)
    length, full = m["arm_length"] + 0.03 - cuff, 1.3 * wrist
    # The cap is as long as the armhole, but for the hollow of its curve.
    cap = float(np.sqrt(max((0.95 * draft.length("front.armhole")) ** 2 - half**2, (0.3 * half) ** 2)))
    at: dict[str, Any] = {"place": shoulder, "turn": 0.5 * np.pi - m["arm_angle"], "label": "arm"}
    curve = (-0.4 * half, 0.0)
    for name, depth in (("front", 0.1), ("back", -0.1)):
        draft.cut(
            f"sleeve_{name}", ("top", (0.0, 0.0)), ("end", (0.0, -length)), ("under", (-full, -length)),
            ("cap", (-half, -cap), (-0.6 * half, -cap), curve), depth=depth, **at,
        )  # fmt: skip
        draft.cut(
            f"cuff_{name}", ("top", (0.0, -length)), ("end", (0.0, -length - cuff)),
            ("under", (-wrist, -length - cuff)), ("sleeve", (-wrist, -length)), depth=depth, **at,
        )  # fmt: skip
        draft.sew((f"sleeve_{name}.cap", f"{name}.armhole"), (f"sleeve_{name}.end", f"cuff_{name}.sleeve"))
    draft.sew(
        *((f"{part}_front.{edge}", f"{part}_back.{edge}") for part in ("sleeve", "cuff") for edge in ("top", "under"))
    )


def _collar(draft: Draft, neck: Point, throat: Point, nape: Point) -> None:
    """A stand round the neck hole, and a fall that lies over it and ends in points."""
    stand, fall, point, placket = 0.03, 0.042, 0.01, throat[0]
    front, back = placket + draft.length("front.neck"), draft.length("back.neck")
    rise = float(np.arctan2(neck[1] - throat[1], neck[0]))
    at: dict[str, Any] = {"place": (0.0, throat[1]), "turn": min(rise, 0.6)}
    draft.cut(
        "stand_front", ("placket", (0.0, 0.0)), ("neck", (placket, 0.0)), ("side", (front, 0.0)),
        ("fall", (front - 0.006, stand)), ("front", (0.004, stand)), depth=0.1, **at,
    )  # fmt: skip
    draft.cut(
        "stand_back", ("neck", (0.0, 0.0)), ("side", (back, 0.0)), ("fall", (back - 0.004, stand)),
        (FOLD, (0.0, stand)), depth=-0.1, place=nape,
    )  # fmt: skip
    draft.cut(
        "fall_front", ("stand", (0.004, stand)), ("side", (front - 0.006, stand)),
        ("end", (front + 0.02, stand + fall)), ("front", (-0.02, stand + fall + point)), depth=0.1, label=FALL, **at,
    )  # fmt: skip
    draft.cut(
        "fall_back", ("stand", (0.0, stand)), ("side", (back - 0.004, stand)), ("end", (back + 0.02, stand + fall)),
        (FOLD, (0.0, stand + fall)), depth=-0.1, label=FALL, place=nape,
    )  # fmt: skip
    draft.sew(
        ("stand_front.neck", "front.neck"), ("stand_front.placket", "placket.neck"), ("stand_back.neck", "back.neck"),
        ("stand_front.side", "stand_back.side"), ("stand_front.front", "stand_front.front"),
        ("fall_front.stand", "stand_front.fall"), ("fall_back.stand", "stand_back.fall"),
        ("fall_front.side", "fall_back.side"),
    )  # fmt: skip


def jeans(m: Measures) -> Pattern:
    """Jeans: legs with a crease in the middle, a yoke at the back that takes the darts, and a waistband.

    Args:
        m: measures from `tailors_measures`.
    """
    draft, band, yoke, ease = Draft("jeans"), 0.04, 0.04, 0.05
    waists, hips = 0.25 * (m["low_waist"] + 0.03), 0.25 * (m["hips"] + ease)
    hem, crotch, top = 0.4 * m["ankle_height"], m["crotch_height"] - 0.015, m["low_waist_height"] - 0.5 * band
    front_fork = m["hips"] / 20.0
    back_fork = max(m["hips"] / 10.0, m["thigh"] + 0.05 - 2.0 * hips - front_fork)
    knee, ankle = m["knee"] + 0.08, m["calf"] + 0.06
    for name, fork, less, slant, raised in (
        ("front", front_fork, 0.01, 0.01, 0.0), ("back", back_fork, -0.01, 0.045, 0.025),
    ):  # fmt: skip
        waist = waists + less
        half, narrow, end = 0.5 * (hips - less + fork), 0.5 * (0.5 * knee - less), 0.5 * (0.5 * ankle - less)
        seat, hip, thigh = fork - half, (half, m["hip_height"]), (half, crotch - 0.05)
        side, middle = (seat + slant + float(np.sqrt(waist**2 - raised**2)), top), (seat + slant, top + raised)
        # The side is full up to half the way from hips to waist.
        full = (half, 0.5 * (hip[1] + top))
        share = 1.0 - yoke / (top - hip[1])
        below, low, above = _split(hip, full, side, share)
        cut = (middle[0] - 0.2 * slant, middle[1] - yoke - 0.5 * raised)
        curve = ((seat, crotch + 0.02), (seat - 0.2 * fork, crotch))
        upper = [("yoke", low, above), ("waist", side), ("crotch", middle, *curve)]
        at: dict[str, Any] = {"depth": 0.2 if name == "front" else -0.2, "place": (half, 0.0), "label": "leg"}
        if name == "back":
            upper = [("yoke", low), ("crotch", cut, *curve)]
            draft.cut("yoke", ("side", low, above), ("waist", side), ("centre", middle), ("leg", cut), **at)
        draft.cut(
            name, ("hem", (-end, hem)), ("shin", (end, hem)), ("side", (narrow, m["knee_height"]), thigh),
            ("hip", hip, below), *upper, ("inner", (-half, crotch), (-narrow, 0.5 * (crotch + m["knee_height"]))),
            ("calf", (-narrow, m["knee_height"])), **at,
        )  # fmt: skip
        draft.cut(
            f"band_{name}", ("top", (0.0, top + band)), ("side", (waist, top + band)), ("waist", (waist, top)),
            (FOLD, (0.0, top)), depth=at["depth"],
        )  # fmt: skip
        draft.sew((f"{name}.crotch", f"{name}.crotch"))
    draft.sew(
        *((f"front.{edge}", f"back.{edge}") for edge in ("shin", "side", "hip", "inner", "calf")),
        ("front.yoke", "yoke.side"), ("yoke.leg", "back.yoke"), ("yoke.centre", "yoke.centre"),
        ("front.waist", "band_front.waist"), ("yoke.waist", "band_back.waist"), ("band_front.side", "band_back.side"),
    )  # fmt: skip
    return draft.pattern()


def circle_dress(m: Measures) -> Pattern:
    """A dress: a fitted bodice with darts from bust, sides and shoulder blades, and a full circle of eight gores.

    Args:
        m: measures from `tailors_measures`.
    """
    draft, waist, level = Draft("circle_dress"), m["waist"] + 0.03, m["waist_height"]
    part, radius = waist / 8.0, waist / (2.0 * np.pi)
    neck, tip = 0.5 * m["neck_width"] + 0.025, _shoulder(m, -0.025)
    back = m["neck_height"] - level + 0.01
    # What the front is longer than the back, over the bust, is taken in by a dart in the side.
    for name, depth, more, intake, dip in (
        ("front", 0.15, 0.01, max(m["front_length"] - back, 0.01), 0.10), ("back", -0.15, -0.01, 0.0, 0.05),
    ):  # fmt: skip
        quarter, high = 0.25 * (m["bust"] + 0.05) + more, level + back + intake
        armhole = (tip[0], high - (m["neck_height"] - tip[1]))
        under = (quarter, armhole[1] - (tip[1] - m["armpit_height"] + 0.015))
        dart = max(quarter - 0.015 - 2.0 * part, 0.015)
        side = (dart + 2.0 * part, level)
        low = 0.6 * (under[1] - intake - level)
        apex = min(m["bust_height"] - 0.03, level + low - 0.01)
        notch = [
            (side[0] + (quarter - side[0]) * (low + up) / (under[1] - level), level + low + up) for up in (intake, 0.0)
        ]
        sides: tuple[Edge, ...] = (("side_high", under), ("side_low", notch[1]))
        if intake:
            tip_of_dart = (part + 0.5 * dart + 0.03, level + low + 0.5 * intake + 0.01)
            sides = (("side_high", under), ("dart_high", notch[0]), ("dart_low", tip_of_dart), ("side_low", notch[1]))
        draft.cut(
            name, ("neck", (0.0, high - dip), (0.9 * neck, high - dip)),
            ("shoulder", (neck, high - 0.4 * (neck - 0.5 * m["neck_width"]))),
            ("armhole", armhole, (armhole[0] - 0.015, 0.5 * (armhole[1] + under[1])), (armhole[0], under[1])), *sides,
            ("side_part", side), ("dart_side", (part + dart, level)), ("dart_middle", (part + 0.5 * dart, apex)),
            ("middle_part", (part, level)), (FOLD, (0.0, level)), depth=depth,
        )  # fmt: skip
        draft.sew((f"{name}.dart_side", f"{name}.dart_middle"))
    draft.sew(*((f"front.{edge}", f"back.{edge}") for edge in ("shoulder", "side_high", "side_low")))
    draft.sew(("front.dart_high", "front.dart_low"))
    around = ("front.middle_part", "front.side_part", "back.side_part", "back.middle_part")
    _circle(draft, around, radius, level - m["knee_height"], level)
    return draft.pattern()


def _circle(draft: Draft, waist: tuple[str, ...], radius: float, length: float, level: float) -> None:
    """A full circle of gores, one below each edge of a waist from the middle of the front to that of the back."""
    turn = np.pi / len(waist)
    start, end = -0.5 * np.pi - 0.5 * turn, -0.5 * np.pi + 0.5 * turn
    for k, edge in enumerate(waist):
        upper, hem = arc(radius, end, start), arc(radius + length, start, end)
        draft.cut(
            f"gore_{k}", ("waist", *upper), ("front", (radius * np.cos(start), radius * np.sin(start))), ("hem", *hem),
            ("back", ((radius + length) * np.cos(end), (radius + length) * np.sin(end))), depth=0.15,
            place=(0.0, level + radius), tilt=0.4, azimuth=(k + 0.5) * turn,
        )  # fmt: skip
        draft.sew((f"gore_{k}.waist", edge))
        if k:
            draft.sew((f"gore_{k - 1}.back", f"gore_{k}.front"))
    draft.sew(("gore_0.front", "gore_0.front"), (f"gore_{len(waist) - 1}.back", f"gore_{len(waist) - 1}.back"))


def _split(start: Point, control: Point, end: Point, share: float) -> tuple[Point, Point, Point]:
    """A quadratic curve cut in two at a share of its parameter: the first's control, the cut, the second's control."""
    one, middle, other = (np.array(point) for point in (start, control, end))
    one, other = one + share * (middle - one), middle + share * (other - middle)
    return tuple(one), tuple(one + share * (other - one)), tuple(other)


def _shoulder(m: Measures, beyond: float) -> Point:
    """Where a shoulder seam ends, so far beyond the top of the joint [m]."""
    out, fall = 0.5 * (m["shoulder_width"] - m["neck_width"]), m["neck_height"] - m["shoulder_height"]
    return 0.5 * m["shoulder_width"] + beyond, m["shoulder_height"] - beyond * fall / out


DRAFTS: dict[str, Callable[[Measures], Pattern]] = {"shirt": shirt, "jeans": jeans, "circle_dress": circle_dress}
"""What is drafted by measure, by name."""
