"""Time into frame numbers."""

from __future__ import annotations

import threading

import pytest

from pb4u.viewer.view_state import PlaybackClock


class Time:
    """Seconds that pass when the test says so."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def __call__(self) -> float:
        return self.seconds


@pytest.fixture
def time() -> Time:
    return Time()


@pytest.fixture
def clock(time: Time) -> PlaybackClock:
    made = PlaybackClock(time)
    made.load(fps=30.0, frame_count=60)
    return made


def test_it_stands_until_it_is_played(clock: PlaybackClock, time: Time) -> None:
    time.seconds = 5.0
    assert (clock.frame, clock.playing) == (0, False)
    clock.play()
    time.seconds += 0.5
    assert (clock.frame, clock.seconds) == (15, 0.5)


def test_speed_counts_from_when_it_is_set(clock: PlaybackClock, time: Time) -> None:
    clock.play()
    time.seconds = 0.5
    clock.speed = 0.1
    time.seconds = 1.5
    assert clock.frame == 15 + 3


def test_it_loops_or_stops_at_the_end(clock: PlaybackClock, time: Time) -> None:
    clock.play()
    time.seconds = 2.0 + 0.1
    assert (clock.frame, clock.playing) == (3, True)
    clock.loop = False
    time.seconds = 9.0
    assert (clock.frame, clock.playing) == (59, False)
    clock.play()
    assert clock.frame == 0


def test_steps_pause_and_go_around_the_ends(clock: PlaybackClock, time: Time) -> None:
    clock.play()
    time.seconds = 0.34
    clock.step(1)
    assert (clock.frame, clock.playing) == (11, False)
    clock.seek(59)
    clock.step(1)
    assert clock.frame == 0
    clock.step(-1)
    assert clock.frame == 59
    clock.loop = False
    clock.step(1)
    assert clock.frame == 59


def test_seeking_goes_to_the_nearest_frame_there_is(clock: PlaybackClock) -> None:
    clock.seek(1000)
    assert clock.frame == 59
    clock.seek(-4)
    assert clock.frame == 0


def test_frames_may_come_while_it_plays(time: Time) -> None:
    clock = PlaybackClock(time)
    assert clock.frame == 0
    clock.load(fps=10.0, frame_count=2)
    clock.loop = False
    clock.play()
    time.seconds = 0.15
    clock.grow(20)
    time.seconds = 1.05
    assert clock.frame == 10


def test_it_waits_just_until_the_next_frame(clock: PlaybackClock, time: Time) -> None:
    clock.play()
    time.seconds = 0.25 / 30.0
    assert clock.wait == pytest.approx(0.75 / 30.0)
    clock.speed = 0.5
    assert clock.wait == pytest.approx(1.5 / 30.0)


def test_a_thread_that_reads_does_not_undo_what_another_sets() -> None:
    """The page reads the clock while a user seeks: the read begins before the seek and ends after it."""
    reading, sought = threading.Event(), threading.Event()

    class Rate(float):
        """Frames per second that the reader stops at, in the middle of its calculation."""

        def __rmul__(self, seconds: float) -> float:
            if threading.current_thread() is reader:
                reading.set()
                sought.wait(10.0)
            return seconds * float(self)

    clock = PlaybackClock(lambda: 1.0)
    clock.load(fps=Rate(30.0), frame_count=60)
    clock.play()
    reader = threading.Thread(target=lambda: clock.frame)
    reader.start()
    assert reading.wait(10.0)
    clock.pause_at(40)
    sought.set()
    reader.join(10.0)
    assert clock.frame == 40
