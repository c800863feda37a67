"""Draws a skirt of four panels, sews it around a body and lets it walk."""

import pb4u


def panel(side, front):
    """A quarter of the skirt: its edges are 1 at the side and 3 at the middle."""
    corners = [(0.0, 0.0), (side * 0.32, 0.0), (side * 0.19, 0.5), (0.0, 0.5)]
    name = f"{'front' if front else 'back'} {'left' if side > 0 else 'right'}"
    # Counter-clockwise as seen from outside: from before the body, or from behind it.
    order = corners if (side > 0) == front else corners[::-1]
    return pb4u.Panel(name, order, position=(0.0, 0.6, 0.25 if front else -0.22), label="leg")


def skirt():
    """Four panels joined at the sides and in the middle, front and back."""
    panels = [panel(side, front) for side in (1, -1) for front in (True, False)]
    seams = [pb4u.Seam((f"front {side}", 1), (f"back {side}", 1)) for side in ("left", "right")]
    seams += [pb4u.Seam((f"{half} left", 3), (f"{half} right", 3)) for half in ("front", "back")]
    return pb4u.Pattern("skirt", panels, seams)


if __name__ == "__main__":
    body = pb4u.load_body("woman")
    dressed = pb4u.dress(skirt(), body, triangles=2000)
    print(f"{len(dressed.garment.faces)} triangles, {dressed.crossings} crossings")
    scene = pb4u.make_scene(dressed.garment, body, "walk", frames=30, pins="waist")
    pb4u.load_simulator().simulate(scene).save("skirt.npz")
