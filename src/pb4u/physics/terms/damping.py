"""Damping of cloth: forces against a change of its shape, whatever the rate of frames.

A force against the change from a shape, beside the elastic force against any, is one elastic force of greater modulus
against a shape between the two: both cost no more than the elastic one alone.
"""

from __future__ import annotations

from torch import Tensor

from pb4u.physics.terms.bending import Bending, bends, hinge_stiffness
from pb4u.physics.terms.stretch import Stretch, green_strains
from pb4u.physics.time_step import TimeStep


class DampedStretch(Stretch):
    """The stretch, and the sum over faces of b A / (2 dt) (G - G0) : C : (G - G0) [J], G0 the strain before the step.

    b is the damping time of the face's material [s], C its four moduli, A its rest area [m^2]. A mode of angular
    frequency w loses pi b w of the logarithm of its amplitude in a period. Source: Rayleigh damping in strain rates, as
    in Brown et al. 2018 (Accurate dissipative forces in optimization integrators).

    With r = b / dt, both are (1 + r) A / 2 (G - G1) : C : (G - G1), G1 = r / (1 + r) G0, but for what is the same
    wherever the step leads, which is left out.
    """

    def resisted(self, step: TimeStep) -> tuple[Tensor | float, Tensor | float]:
        garments = step.garments
        if not garments.damps:
            return super().resisted(step)
        rate = garments.damping / step.dt
        return 1.0 + rate, rate / (1.0 + rate) * green_strains(garments, step.state.positions)


class DampedBending(Bending):
    """The bending, and the sum over hinges of b k / (4 (A1 + A2)) (l theta - l0 theta0)^2 / (2 dt) [J].

    b is the mean damping time of both faces [s], l0 theta0 the value before the step; the rest as in `Bending`, and
    both in one as in `DampedStretch`.
    """

    def resisted(self, step: TimeStep) -> tuple[Tensor, Tensor | float]:
        garments = step.garments
        if not garments.damps:
            return super().resisted(step)
        rate = garments.hinge_damping / step.dt
        bent = rate / (1.0 + rate) * bends(garments, step.state.positions)
        return (1.0 + rate) * hinge_stiffness(garments), bent


DAMPED = (DampedStretch(), DampedBending())
"""The elastic energies of a simulation; tables of the six have those without damping."""
