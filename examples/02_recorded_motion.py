"""Let a body perform a recording: CMU (.amc with its .asf), BVH, AMASS (.npz) or VTO (.pkl).

    python examples/02_recorded_motion.py 07_02.amc
    python examples/02_recorded_motion.py clip.npz --crop 100 400 --arms-away 8

CMU recordings are free at mocap.cs.cmu.edu, AMASS needs a registration at amass.is.tue.mpg.de.
"""

from __future__ import annotations

import argparse
import warnings

import pb4u


def main() -> None:
    """Read a recording, say what is in it, and dress it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording")
    parser.add_argument("--crop", type=int, nargs=2, metavar=("FIRST", "STOP"), help="frames to use, at its own rate")
    parser.add_argument(
        "--arms-away", type=float, help="degrees to hold hanging arms off the torso; default: as needed"
    )
    parser.add_argument("--garment", default="tshirt")
    parser.add_argument("--body", default="woman")
    parser.add_argument("--triangles", type=int, default=2500)
    parser.add_argument("--model", default="auto")
    parser.add_argument("--out", default="recorded.npz")
    options = parser.parse_args()
    crop = None if options.crop is None else (options.crop[0], options.crop[1])

    # Any recording is retargeted to any body: only directions of bones are taken from it, not their lengths.
    motion = pb4u.load_motion(options.recording, crop=crop, arms_away_degrees=options.arms_away)
    print(f"{options.recording}: {motion.duration:.2f} s, {motion.available_frames(30.0)} frames at 30 per second")

    # Before the first frame of the recording, a second of lead-in takes the body there from its rest pose, so that
    # the garment, which is made for the rest pose, arrives unhurried. The lead-in is simulated, not written.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # the notes below
        scene = pb4u.make_scene(
            options.garment,
            options.body,
            motion,
            triangles=options.triangles,
            lead_in=30,
        )
    for note in scene.notes:  # what was repaired: a T-pose before the start, flipped joints, arms inside the body ...
        print("note:", note)
    trajectory = pb4u.load_simulator(options.model).simulate(scene)

    measured = pb4u.measure(trajectory)["metrics"]
    print(f"deepest penetration {1000 * measured['penetration_depth_max']['max']:.1f} mm: if arms press cloth into")
    print("the body, that is the recording; hold them off with --arms-away 8")
    print("written:", trajectory.save(options.out))


if __name__ == "__main__":
    try:
        main()
    except pb4u.Pb4uError as error:
        raise SystemExit(str(error)) from None
