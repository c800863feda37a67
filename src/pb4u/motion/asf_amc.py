"""CMU Acclaim files: a skeleton (.asf) and the recordings made with it (.amc)."""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pb4u.body.skeleton import PoseSequence, Skeleton, world_rotations
from pb4u.errors import InputError
from pb4u.geometry.rotation import conjugate, from_euler, multiply, rotate
from pb4u.motion.correspondences import CMU
from pb4u.motion.recording import Recording, finite_frames

# The database names no rate; its trials were captured at 120 Hz.
CAPTURE_RATE = 120.0
_DEGREES_OF_FREEDOM = ("rx", "ry", "rz", "tx", "ty", "tz", "l")


@dataclass(frozen=True, eq=False)
class AcclaimSkeleton:
    """An .asf skeleton in its rest pose; lengths in the file's own unit.

    Args:
        skeleton: heads of the bones.
        axes: (bones, 4) wxyz, the rotation C from each bone's axes to the world's.
        channels: names of the channels that an .amc line of each bone holds, in order.
    """

    skeleton: Skeleton
    axes: np.ndarray
    channels: tuple[tuple[str, ...], ...]


def read_asf(path: Path) -> AcclaimSkeleton:
    """A skeleton in its rest pose.

    Args:
        path: the .asf.

    Raises:
        InputError: it is cut short or is not such a file.
    """
    sections = _sections(path)
    missing = [name for name in ("root", "bonedata", "hierarchy") if not sections.get(name)]
    if missing:
        raise InputError(f"{path} has no :{missing[0]} section; it is cut short or is not an ASF skeleton.")
    degrees = "rad" not in " ".join(sections.get("units", ["angle deg"])).lower()
    bones = _bones(path, sections["bonedata"])
    bones["root"] = _root(path, sections["root"])
    parents = _parents(path, sections["hierarchy"], bones)

    names = tuple(parents)
    parent_index = np.array([names.index(p) if p else -1 for p in parents.values()], dtype=np.int64)
    joints = np.zeros((len(names), 3))
    for i, parent in enumerate(parent_index.tolist()):
        if parent >= 0:
            # A bone's head is its parent's tail.
            joints[i] = joints[parent] + bones[names[parent]].offset
    axes = np.stack([from_euler(bones[n].axis_angles[None], bones[n].axis_order, degrees)[0] for n in names])
    channels = tuple(bones[name].channels for name in names)
    return AcclaimSkeleton(Skeleton(names, parent_index, joints), axes, channels)


def find_asf(amc: Path) -> Path:
    """The skeleton beside a trial: named like its subject (07_02.amc -> 07.asf), or the only one in the folder.

    Args:
        amc: the trial.

    Raises:
        InputError: there is none, or several without a match.
    """
    beside = sorted(p for p in amc.parent.iterdir() if p.suffix.lower() == ".asf")
    subjects = (amc.stem, amc.stem.split("_")[0])
    named = [p for subject in subjects for p in beside if p.stem == subject]
    if named or len(beside) == 1:
        return (named or beside)[0]
    what = f"{len(beside)} .asf skeletons, none called {subjects[-1]}.asf" if beside else "no .asf skeleton"
    raise InputError(f"{amc}: its folder holds {what}; put the skeleton {subjects[-1]}.asf beside the recording.")


def read_amc(path: Path) -> Recording:
    """A CMU trial, in the file's unit of length, with the skeleton that `find_asf` gives.

    World rotation of a bone = parent's C R C^T, with R from its Euler angles and C from the skeleton's `axis`.

    Args:
        path: the .amc.

    Raises:
        InputError: the recording is cut short or does not fit the skeleton (naming frame and bone), or there is none.
    """
    asf = find_asf(path)
    rest = read_asf(asf)
    if missing := sorted(CMU.bones - set(rest.skeleton.names)):
        raise InputError(
            f"{asf} lacks the bones {', '.join(missing[:6])} of a CMU skeleton; rename its bones as the database does."
        )
    names, values, degrees = _read_frames(path, rest, asf)
    frames = len(values)
    skeleton = rest.skeleton
    starts = dict(zip(names, np.cumsum([0] + [len(rest.channels[skeleton.index(n)]) for n in names]), strict=False))
    local = np.zeros((frames, skeleton.bone_count, 4))
    local[..., 0] = 1.0
    root_positions = np.zeros((frames, 3))
    for i, (name, parent) in enumerate(zip(skeleton.names, skeleton.parents.tolist(), strict=True)):
        channels = rest.channels[i]
        if name in starts:
            block = values[:, starts[name] : starts[name] + len(channels)]
            turning = [k for k, channel in enumerate(channels) if channel[0] == "r"]
            if turning:
                order = "".join(channels[k][1] for k in turning)
                turned = from_euler(block[:, turning], order, degrees)
                local[:, i] = multiply(multiply(rest.axes[i], turned), conjugate(rest.axes[i]))
            if parent < 0:
                for k, channel in enumerate(channels):
                    if channel[0] == "t":
                        root_positions[:, "xyz".index(channel[1])] = block[:, k]
    root_positions = rotate(rest.axes[0], root_positions)
    poses = PoseSequence(world_rotations(local, skeleton.parents), root_positions, CAPTURE_RATE)
    return Recording(path.stem, CMU, skeleton, poses).with_vertical_legs()


@dataclass(frozen=True, eq=False)
class _Bone:
    offset: np.ndarray
    axis_angles: np.ndarray
    axis_order: str
    channels: tuple[str, ...]


def _sections(path: Path) -> dict[str, list[str]]:
    """The lines under each `:keyword`, comments dropped."""
    sections: dict[str, list[str]] = {}
    current: list[str] = []
    for line in path.read_text(encoding="latin-1").splitlines():
        text = line.split("#")[0].strip()
        if text.startswith(":"):
            keyword, _, rest = text[1:].partition(" ")
            current = sections.setdefault(keyword.lower(), [])
            text = rest.strip()
        if text:
            current.append(text)
    return sections


def _numbers(path: Path, words: list[str], count: int, what: str) -> np.ndarray:
    try:
        values = np.array([float(word) for word in words[:count]])
    except ValueError:
        values = np.empty(0)
    if len(values) != count or not np.isfinite(values).all():
        raise InputError(f'{path}: {what} should be {count} number(s), found "{" ".join(words)}".')
    return values


def _bones(path: Path, lines: list[str]) -> dict[str, _Bone]:
    bones: dict[str, _Bone] = {}
    fields: dict[str, list[str]] | None = None
    for line in lines:
        key, *words = line.split()
        if key == "begin":
            fields = {}
        elif key == "end":
            if not fields or not {"name", "direction", "length", "axis"} <= set(fields):
                raise InputError(f"{path}: bone {len(bones) + 1} lacks its name, direction, length or axis.")
            name = fields["name"][0]
            direction = _numbers(path, fields["direction"], 3, f"direction of bone {name}")
            length = _numbers(path, fields["length"], 1, f"length of bone {name}")
            angles = _numbers(path, fields["axis"], 3, f"axis of bone {name}")
            order = _axis_order(path, fields["axis"][3] if len(fields["axis"]) > 3 else "xyz", f"bone {name}")
            if length <= 0.0 or not direction.any():
                raise InputError(f"{path}: bone {name} has no length or no direction; every bone needs both.")
            channels = tuple(word.lower() for word in fields.get("dof", []))
            if not set(channels) <= set(_DEGREES_OF_FREEDOM):
                raise InputError(f'{path}: bone {name} has an unknown degree of freedom in "{" ".join(channels)}".')
            direction /= float(np.linalg.norm(direction))
            if name in bones:
                raise InputError(f"{path} describes the bone {name} twice.")
            bones[name] = _Bone(direction * length, angles, order, channels)
            fields = None
        elif fields is not None:
            fields[key] = words
    if fields is not None:
        raise InputError(f"{path} is cut short inside the bone after {len(bones)} complete ones.")
    return bones


def _root(path: Path, lines: list[str]) -> _Bone:
    fields = {words[0].lower(): words[1:] for words in map(str.split, lines) if words}
    channels = tuple(word.lower() for word in fields.get("order", ["tx", "ty", "tz", "rx", "ry", "rz"]))
    orientation = _numbers(path, fields.get("orientation", ["0", "0", "0"]), 3, "orientation of the root")
    if not set(channels) <= set(_DEGREES_OF_FREEDOM):
        raise InputError(f'{path}: the root has an unknown degree of freedom in "{" ".join(channels)[:80]}".')
    order = _axis_order(path, (fields.get("axis") or ["xyz"])[0], "the root")
    return _Bone(np.zeros(3), orientation, order, channels)


def _axis_order(path: Path, text: str, what: str) -> str:
    if sorted(text.lower()) != ["x", "y", "z"]:
        raise InputError(f'{path}: the axis order of {what} should be one such as XYZ, found "{text[:20]}".')
    return text.lower()


def _parents(path: Path, lines: list[str], bones: dict[str, _Bone]) -> dict[str, str]:
    """Bone -> parent ("" for the root), parents first."""
    parents = {"root": ""}
    for line in lines:
        parent, *children = line.split()
        if parent in ("begin", "end"):
            continue
        for name in (parent, *children):
            if name not in bones:
                raise InputError(f'{path}: the hierarchy names a bone "{name}" without data; the file is cut short.')
        if twice := [child for child in children if child in parents]:
            raise InputError(f'{path}: the hierarchy gives the bone "{twice[0]}" a second parent, or one below itself.')
        if parent not in parents:
            raise InputError(f'{path}: bone "{parent}" has children before it has a parent.')
        parents |= {child: parent for child in children}
    return parents


def _read_frames(path: Path, rest: AcclaimSkeleton, asf: Path) -> tuple[list[str], np.ndarray, bool]:
    """Bone names in file order, channel values (frames, channels), and whether angles are in degrees."""
    lines = map(str.split, path.read_text(encoding="latin-1").splitlines())
    degrees = True
    for words in lines:
        if [word.upper() for word in words] == [":RADIANS"]:
            degrees = False
        if len(words) == 1 and words[0].isdigit():
            break
    else:
        raise InputError(f"{path} holds no frames.")
    known = dict(zip(rest.skeleton.names, rest.channels, strict=True))
    moving = {name for name, channels in known.items() if channels}
    names: list[str] = []
    values = array("d")
    frames, row = 1, 0
    for words in filter(None, lines):
        if frames == 1 and len(words) > 1:
            if words[0] not in known:
                raise InputError(
                    f'{path} moves a bone "{words[0]}" that {asf.name} does not have; give the skeleton it was '
                    "recorded with."
                )
            names.append(words[0])
        elif row == len(names):
            _require_bones(path, moving, names, asf)
            if len(words) != 1:
                raise _damaged(path, frames + 1, words, "a frame number")
            frames, row = frames + 1, 0
            continue
        if words[0] != names[row] or len(words) != 1 + len(known[names[row]]):
            raise _damaged(path, frames, words, f"{names[row]} with {len(known[names[row]])} number(s)")
        try:
            values.extend(map(float, words[1:]))
        except ValueError as problem:
            raise InputError(f"{path} has a word where a number should be: {problem}.") from None
        row += 1
    _require_bones(path, moving, names, asf)
    if row < len(names):
        raise InputError(f"{path} is cut short: frame {frames} has {row} of its {len(names)} bones.")
    return names, finite_frames(np.frombuffer(values).reshape(frames, -1), path), degrees


def _require_bones(path: Path, moving: set[str], names: list[str], asf: Path) -> None:
    if missing := sorted(moving - set(names)):
        raise InputError(f"{path} is cut short: the first frame lacks the bones {', '.join(missing)} of {asf.name}.")


def _damaged(path: Path, frame: int, words: list[str], wanted: str) -> InputError:
    found = " ".join(words)[:80]
    return InputError(f'{path} is damaged or cut short: frame {frame} reads "{found}" instead of {wanted}.')
