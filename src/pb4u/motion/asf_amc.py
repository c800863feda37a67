"""CMU Acclaim files: a skeleton (.asf) and the recordings made with it (.amc)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pb4u.body.bone_names import unknown_bones
from pb4u.body.skeleton import PoseSequence, Skeleton, world_rotations
from pb4u.errors import InputError
from pb4u.geometry.rotation import conjugate, from_euler, multiply, rotate
from pb4u.io.reading_limits import refusing
from pb4u.motion.correspondences import roles_of
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
    with refusing(path, "is cut short or is not an ASF skeleton"):
        sections = _sections(path)
        degrees = "rad" not in " ".join(sections.get("units", ["angle deg"])).lower()
        bones = _bones(sections["bonedata"]) | {"root": _root(sections["root"])}
        parents = _parents(sections["hierarchy"], bones)

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
        InputError: there is no skeleton, or several without a match.
    """
    beside = sorted(p for p in amc.parent.iterdir() if p.suffix.lower() == ".asf")
    subjects = (amc.stem, amc.stem.split("_")[0])
    matches = [p for subject in subjects for p in beside if p.stem == subject]
    if matches or len(beside) == 1:
        return (matches or beside)[0]
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
    bones, parents = rest.skeleton.names, rest.skeleton.parents.tolist()
    source = roles_of(bones, parents)
    if source is None:
        raise InputError(
            f"{asf}: its bones are not those of a human; {unknown_bones(bones, parents)}: rename them as the database "
            "does."
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
    return Recording(path.stem, source, skeleton, poses).with_vertical_legs()


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


def _numbers(words: list[str], count: int) -> np.ndarray:
    values = np.array([float(word) for word in words[:count]])
    if len(values) != count or not np.isfinite(values).all():
        raise ValueError(f'"{" ".join(words)[:80]}" where {count} number(s) should be')
    return values


def _bones(lines: list[str]) -> dict[str, _Bone]:
    bones: dict[str, _Bone] = {}
    fields: dict[str, list[str]] = {}
    for line in lines:
        key, *words = line.split()
        if key == "begin":
            fields = {}
        elif key != "end":
            fields[key] = words
        elif not {"name", "direction", "length", "axis"} <= set(fields):
            raise ValueError(f"bone {len(bones) + 1} lacks its name, direction, length or axis")
        else:
            name, direction, length = fields["name"][0], _numbers(fields["direction"], 3), _numbers(fields["length"], 1)
            if length <= 0.0 or not direction.any() or name in bones:
                raise ValueError(f"bone {name} has no length or no direction, or appears twice")
            order = fields["axis"][3] if len(fields["axis"]) > 3 else "xyz"
            direction /= float(np.linalg.norm(direction))
            turn = _numbers(fields["axis"], 3), _axis_order(order), _channels(fields.get("dof", []))
            bones[name] = _Bone(direction * length, *turn)
            fields = {}
    if fields:
        raise ValueError(f"it ends inside bone {len(bones) + 1}")
    return bones


def _root(lines: list[str]) -> _Bone:
    fields = {words[0].lower(): words[1:] for words in map(str.split, lines) if words}
    channels = _channels(fields.get("order", ["tx", "ty", "tz", "rx", "ry", "rz"]))
    orientation = _numbers(fields.get("orientation", ["0", "0", "0"]), 3)
    return _Bone(np.zeros(3), orientation, _axis_order((fields.get("axis") or ["xyz"])[0]), channels)


def _channels(words: list[str]) -> tuple[str, ...]:
    channels = tuple(word.lower() for word in words)
    if not set(channels) <= set(_DEGREES_OF_FREEDOM):
        raise ValueError(f'an unknown degree of freedom in "{" ".join(channels)[:80]}"')
    return channels


def _axis_order(text: str) -> str:
    if sorted(text.lower()) != ["x", "y", "z"]:
        raise ValueError(f'the axis order should be one such as XYZ, not "{text[:20]}"')
    return text.lower()


def _parents(lines: list[str], bones: dict[str, _Bone]) -> dict[str, str]:
    """Bone -> parent ("" for the root), parents first."""
    parents = {"root": ""}
    for line in lines:
        parent, *children = line.split()
        if parent in ("begin", "end"):
            continue
        if unknown := [name for name in (parent, *children) if name not in bones]:
            raise ValueError(f'the hierarchy names a bone "{unknown[0]}" without data')
        if parent not in parents or any(child in parents for child in children):
            raise ValueError(
                f'the hierarchy gives a bone below "{parent}" a second parent, or names it before its own parent'
            )
        parents |= dict.fromkeys(children, parent)
    return parents


def _read_frames(path: Path, rest: AcclaimSkeleton, asf: Path) -> tuple[list[str], np.ndarray, bool]:
    """Bone names in file order, channel values (frames, channels), and whether angles are in degrees."""
    lines = [words for line in path.read_text(encoding="latin-1").splitlines() if (words := line.split())]
    first = next((k for k, words in enumerate(lines) if len(words) == 1 and words[0].isdigit()), len(lines))
    degrees = [":RADIANS"] not in [[word.upper() for word in words] for words in lines[:first]]
    lines = lines[first:]
    if not lines:
        raise InputError(f"{path} holds no frames; export it again.")
    size = next((k for k, words in enumerate(lines[1:], 1) if len(words) == 1), len(lines))
    names = [words[0] for words in lines[1:size]]
    channels_of = dict(zip(rest.skeleton.names, rest.channels, strict=True))
    if unknown := [name for name in names if name not in channels_of]:
        raise InputError(
            f'{path} moves a bone "{unknown[0]}" that {asf.name} does not have; give the skeleton it was recorded with.'
        )
    if missing := sorted({name for name, channels in channels_of.items() if channels} - set(names)):
        raise InputError(f"{path} is cut short: the first frame lacks the bones {', '.join(missing)} of {asf.name}.")
    values: list[float] = []
    for k, words in enumerate(lines):
        frame, row = k // size + 1, k % size
        name = names[row - 1] if row else ""
        expected = f"{name} with {len(channels_of[name])} number(s)" if row else "a frame number"
        if len(words) != (1 + len(channels_of[name]) if row else 1) or (row and words[0] != name):
            text = " ".join(words)[:80]
            raise InputError(f'{path} is damaged or cut short: frame {frame} reads "{text}" instead of {expected}.')
        with refusing(path, "has a word where a number should be"):
            values += map(float, words[1:])
    if len(lines) % size:
        raise InputError(
            f"{path} is cut short: frame {len(lines) // size + 1} has {len(lines) % size - 1} of its {size - 1} bones."
        )
    return names, finite_frames(np.array(values).reshape(len(lines) // size, -1), path), degrees
