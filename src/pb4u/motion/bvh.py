"""Biovision hierarchy files (.bvh) of human skeletons, whatever their joints are called and rest in."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from pb4u.body.bone_names import SCHEMES, unknown_bones
from pb4u.body.skeleton import PoseSequence, Skeleton, world_rotations
from pb4u.errors import InputError
from pb4u.geometry.rotation import from_euler, rotate
from pb4u.io.reading_limits import refusing
from pb4u.io.stored_numbers import unrounded_rate
from pb4u.motion.correspondences import SkeletonRoles, roles_of
from pb4u.motion.recording import Recording, finite_frames, require_rate
from pb4u.motion.rest_pose import standing_at_rest

_HEADING = 200
"""Characters of the MOTION section that hold its number of frames and its frame time."""
_STRETCH = 0.01
"""Share of the length of a leg by which joints may move against their parents without a word."""
_END, _LONGEST = -2, 80
"""What stands for the end of a chain, which is not a joint, and the characters of a name that count."""
_CHANNELS = {f"{axis}{kind}" for axis in "XYZ" for kind in ("position", "rotation")}


@dataclass(frozen=True, eq=False)
class _Joint:
    name: str
    parent: int
    offset: np.ndarray
    channels: tuple[str, ...]
    first_channel: int


def read_bvh(path: Path) -> Recording:
    """Recording in a BVH file, in its own unit of length, Y up, from a rest pose that stands on vertical legs.

    Args:
        path: the .bvh.

    Raises:
        InputError: it is cut short or malformed (naming the joint or frame), has no frames or no frame time, or its
            joints are not of a known skeleton, or make no person in its frames.
    """
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    if "." not in text:  # written where numbers have a decimal comma
        text = text.replace(",", ".")
    head, motion, tail = text.partition("MOTION")
    if not motion or not head.lstrip().upper().startswith("HIERARCHY"):
        missing = (
            "MOTION section, as it is cut short" if "HIERARCHY" in head else "HIERARCHY, as it is not a BVH recording"
        )
        raise InputError(f"{path} has no {missing}; export it again as BVH.")
    with refusing(path, "is cut short in its HIERARCHY, or damaged"):
        joints = _hierarchy(head)
    source = _source(path, joints)
    values, fps = _motion(path, tail, sum(len(joint.channels) for joint in joints))

    local = np.empty((len(values), len(joints), 4))
    rest = np.zeros((len(joints), 3))
    for i, joint in enumerate(joints):
        columns = list(range(joint.first_channel, joint.first_channel + len(joint.channels)))
        turning = [c for c in columns if joint.channels[c - joint.first_channel].endswith("rotation")]
        # The channel written first turns last.
        order = "".join(joint.channels[c - joint.first_channel][0] for c in reversed(turning))
        local[:, i] = from_euler(values[:, turning[::-1]], order) if turning else [1.0, 0.0, 0.0, 0.0]
        rest[i] = (rest[joint.parent] if joint.parent >= 0 else 0.0) + joint.offset
    parents = np.array([joint.parent for joint in joints], dtype=np.int64)
    skeleton = Skeleton(tuple(joint.name for joint in joints), parents, rest)
    rotations = world_rotations(local, parents)
    root_positions = _places(joints[0], values)
    # The pelvis need not be the root: what moves it against those above it moves the whole body.
    carrying = _chain(joints, skeleton.index(str(source.roles["pelvis"])))
    for i in carrying - {0}:
        root_positions += rotate(rotations[:, joints[i].parent], _places(joints[i], values) - joints[i].offset)
    recording = Recording(path.stem, source, skeleton, PoseSequence(rotations, root_positions, fps))
    least = _STRETCH * recording.leg_length
    moving = [i for i in range(len(joints)) if np.ptp(_places(joints[i], values), axis=0).max() > least]
    ignored = [skeleton.names[i] for i in moving if i not in carrying]
    if ignored:
        note = f"{path.stem}: bones keep their lengths; the positions of {', '.join(ignored[:6])} are not followed."
        recording = replace(recording, notes=(note,))
    return standing_at_rest(recording, path).with_vertical_legs()


def _places(joint: _Joint, values: np.ndarray) -> np.ndarray:
    """Places (frames, 3) of a joint in the axes of its parent: its offset, where no position channel says otherwise."""
    places = np.tile(joint.offset, (len(values), 1))
    for k, channel in enumerate(joint.channels, joint.first_channel):
        if channel.endswith("position"):
            places[:, "XYZ".index(channel[0])] = values[:, k]
    return places


def _chain(joints: list[_Joint], joint: int) -> set[int]:
    """A joint and all above it."""
    chain = set()
    while joint >= 0:
        chain.add(joint)
        joint = joints[joint].parent
    return chain


def _hierarchy(text: str) -> list[_Joint]:
    words = iter(text.split()[1:])
    joints: list[_Joint] = []
    parents: list[int] = []
    name, count = "", 0
    for word in words:
        keyword = word.upper()
        if keyword in ("ROOT", "JOINT"):
            # Up to the brace, since 3ds Max puts spaces into names; without the namespace that exporters put before it.
            name = " ".join(iter(partial(next, words, "{"), "{")).rpartition(":")[2][:_LONGEST]
            if keyword == "ROOT" and joints:
                raise ValueError(f'a second root, "{name}"; a recording of one person has one')
            while any(name == joint.name for joint in joints):
                name += "'"
            joints.append(_Joint(name, parents[-1] if parents else -1, np.zeros(3), (), count))
            parents.append(len(joints) - 1)
        elif keyword == "END":
            if [next(words, "").upper(), next(words, "")] != ["SITE", "{"]:
                raise ValueError(f'the end after joint "{name}" is no "End Site"')
            parents.append(_END)
        elif keyword == "}":
            parents.pop()
        elif keyword == "OFFSET":
            offset = np.array([float(next(words, "")) for _ in range(3)])
            if parents[-1] != _END:
                joints[-1] = replace(joints[-1], offset=offset)
        elif keyword == "CHANNELS":
            channels = tuple(next(words, "").capitalize() for _ in range(int(next(words, ""))))
            if joints[-1].channels or not set(channels) <= _CHANNELS:
                raise ValueError(f'joint "{joints[-1].name}" has its CHANNELS twice, or unknown ones: {channels}')
            joints[-1] = replace(joints[-1], channels=channels, first_channel=count)
            count += len(channels)
        else:
            raise ValueError(f'"{word[:60]}" after joint "{name}" is no part of a hierarchy')
    if parents or not joints or not all(np.isfinite(joint.offset).all() for joint in joints):
        raise ValueError(f'it ends after joint "{name}", or an offset is not finite')
    return joints


def _source(path: Path, joints: list[_Joint]) -> SkeletonRoles:
    names = [joint.name for joint in joints]
    parents = [joint.parent for joint in joints]
    source = roles_of(names, parents)
    if source is None:
        raise InputError(
            f"{path}: its joints ({', '.join(sorted(names)[:6])}, ..) match no known skeleton; "
            f"{unknown_bones(names, parents)}: rename the joints like one of {', '.join(SCHEMES)}."
        )
    return source


def _motion(path: Path, text: str, channels: int) -> tuple[np.ndarray, float]:
    """Channel values (frames, channels) and frames per second."""
    heading = text[:_HEADING].replace(":", ": ")
    *words, following = (heading.split(None, 5) + [""] * 6)[:6]
    lower = [word.lower() for word in words]
    if not words[4] or lower[0] != "frames:" or lower[2:4] != ["frame", "time:"]:
        raise InputError(f'{path}: MOTION does not begin with "Frames:" and "Frame Time:"; the file is cut short.')
    with refusing(path, "has a word where a number should be"):
        frames, frame_time = int(words[1]), float(words[4])
        values = np.array([float(word) for word in (following + text[_HEADING:]).split()])
    if frames < 1:
        raise InputError(f"{path} holds no frames; export it again.")
    if not 0.0 < frame_time < np.inf:
        raise InputError(f"{path}: the frame time is {frame_time:g} s; it should be positive, such as 0.00833333.")
    count = len(values)
    if count < frames * channels:
        raise InputError(
            f"{path} is cut short: it should have {frames} frames of {channels} numbers, and ends in frame "
            f"{count // channels + 1}."
        )
    if count % channels:
        fault = f"not the {frames} frames of {channels} that its header tells"
        raise InputError(f"{path} has {count} numbers, {fault}; export it again.")
    if count > frames * channels:  # Rokoko's count is one short
        frames = count // channels
    require_rate(1.0 / frame_time, path)
    return finite_frames(values.reshape(frames, channels), path), unrounded_rate(1.0 / frame_time)
