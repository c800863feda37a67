"""Units of length of files that name none or a wrong one, told by the size of a person."""

from __future__ import annotations

import numpy as np

from pb4u.errors import InputError, unknown_name

UNITS = {
    "metres": 1.0, "centimetres": 0.01, "millimetres": 0.001, "inches": 0.0254, "decimetres": 0.1, "feet": 0.3048
}  # fmt: skip
"""Name of a unit -> its length [m]; the likelier come first."""

# Extents [m] of a grown-up and of a person at all, who stands, lies, or spreads arms; those of grown-ups in the units
# above are apart from each other.
_GROWN, _PERSON = (1.4, 2.1), (0.5, 2.4)
# Extent [m] of what is dressed and no person, such as a doll or a giant: taken in metres alone, which files are in.
_FIGURE = (0.1, 4.5)
# Extent [m] of a figure whose unit is given.
_GIVEN = (0.05, 20.0)
# Extent [m] of a garment, and of any: a sock for a doll, a train of a wedding dress.
_CLOTH, _ANY_CLOTH = (0.3, 1.8), (0.05, 5.0)


def body_unit(file: object, extent: float, unit: str | None = None) -> tuple[str, str | None]:
    """The unit of a body's file, and a note for the user if it is not the metre.

    If the size is that of an adult in one of the units, this unit is used. Otherwise metres are used if a person or a
    figure can have this size in metres, or another unit if a person can have it in this one only.

    Args:
        file: of the body, for the sentences.
        extent: largest of the body along an axis, in the unit of the file.
        unit: unit given by the user.

    Raises:
        InputError: the given unit is unknown or gives no possible figure, or no unit or several give a person.
    """
    shown = f"{extent:.3g}" if extent < 1000.0 else f"{extent:.0f}"
    if unit is not None:
        if unit not in UNITS:
            raise unknown_name("unit of length", unit, UNITS)
        if not _GIVEN[0] <= extent * UNITS[unit] <= _GIVEN[1]:
            raise InputError(f"{file} measures {shown} {unit}, which is not the size of a person; give its unit.")
        return unit, None
    grown, people = (
        [unit for unit, length in UNITS.items() if low <= extent * length <= high] for low, high in (_GROWN, _PERSON)
    )
    if _FIGURE[0] <= extent <= _FIGURE[1]:
        people = grown = ["metres"]
    units = grown or people
    if len(units) != 1:
        likely = f"a person in {' or in '.join(units)}" if units else "no person in any known unit"
        raise InputError(
            f"{file}: the body measures {shown} in its own unit, {likely}; say which with --body-units (in Python "
            f"units=), one of {', '.join(UNITS)}, or scale it to metres."
        )
    if units == ["metres"]:
        return "metres", None
    return units[0], (
        f"it measures {shown}, so it is read in {units[0]}, {extent * UNITS[units[0]]:.2f} m; --body-units says "
        "otherwise."
    )


def is_person(extent: float) -> bool:
    """Whether an extent [m] is possible for a person.

    Args:
        extent: largest along an axis [m].
    """
    return _PERSON[0] <= extent <= _PERSON[1]


def garment_unit(extent: float) -> str | None:
    """Verb phrase on the likely unit of a garment of this extent; None if it can be in metres.

    Args:
        extent: largest of the garment along an axis, as in its file.
    """
    if extent < _ANY_CLOTH[0]:
        return f"spans {1000 * extent:.3g} mm if read as metres, too small for a garment"
    if extent <= _ANY_CLOTH[1]:
        return None
    usual = [unit for unit, length in UNITS.items() if _CLOTH[0] <= extent * length <= _CLOTH[1]]
    units = " or in ".join(usual) or ("centimetres" if extent <= 250.0 else "millimetres")
    return f"spans {extent:.0f} m if read as metres, so it seems to be in {units}"


def extent_of(vertices: np.ndarray) -> float:
    """Largest extent along an axis of (vertices, 3), in their unit.

    Args:
        vertices: (vertices, 3).
    """
    return float(np.ptp(vertices, axis=0).max())
