"""What is sewn to the cloth of a garment: interfacing and elastic of its faces, and all of it by part."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pb4u.garment.material import Material


@dataclass(frozen=True, eq=False)
class Trims:
    """Interfacing and elastic of the faces of a garment; for a face partly covered, the area-weighted mean.

    Elastic gathers cloth: its whole mass is on the length of the elastic, and its threads do not stiffen before the
    elastic is stretched to the length of the cloth.

    Args:
        interfacing: (faces,) float64 bending stiffness that is added to that of the cloth [N m].
        elastic: (faces,) float64 rest length along the border over that of the cloth.
    """

    interfacing: np.ndarray
    elastic: np.ndarray

    @staticmethod
    def none(count: int) -> Trims:
        """Trims of faces that have neither interfacing nor elastic.

        Args:
            count: number of faces.
        """
        return Trims(np.zeros(count), np.ones(count))

    @property
    def columns(self) -> np.ndarray:
        """Interfacing and elastic side by side, (faces, 2)."""
        return np.stack([self.interfacing, self.elastic], axis=1)

    def at(self, faces: np.ndarray) -> Trims:
        """Trims of some of the faces.

        Args:
            faces: (...) int64.
        """
        return Trims(self.interfacing[faces], self.elastic[faces])

    def changed(self, name: str, values: np.ndarray) -> np.ndarray:
        """A property of the cloth with interfacing and elastic, computed from that of the plain cloth, in its unit.

        Args:
            name: attribute of `Material`.
            values: (faces,) or (faces, numbers) of the plain cloth.
        """
        if name == "density":
            return values / self.elastic
        if name == "bending":
            return values + 4.0 * self.interfacing
        if name == "stiffening":
            strain, growth = values.T
            return np.stack([(1.0 + strain) / np.minimum(self.elastic, 1.0) - 1.0, growth], axis=1)
        return values


@dataclass(frozen=True)
class SewnPart:
    """Material and trims requested for a part of a garment; None leaves them unchanged.

    Args:
        name: of the part.
        material: that it is made of.
        layers: number of layers.
        interfacing: bending stiffness that is added [N m].
        elastic: rest length along the border over that of the cloth.
        width: of a band [m]; None of a piece.
    """

    name: str
    material: Material | None = None
    layers: float | None = None
    interfacing: float | None = None
    elastic: float | None = None
    width: float | None = None

    def with_all_of(self, other: SewnPart) -> SewnPart:
        """Copy with the values of a later request, where it has any.

        Args:
            other: of the same name.
        """
        return replace(self, **{name: value for name, value in vars(other).items() if value is not None})
