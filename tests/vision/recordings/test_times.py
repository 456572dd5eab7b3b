"""Files of times of frames: what their numbers are is read or asked for, and rounded times find their grid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tossid.errors import FileError
from tossid.vision.recordings.times import check_rate, evened, read_times, time_of, usual_rate

TIMES = np.array([2.5, 2.51, 2.52, 2.54, 2.55])
"""[s]; a frame is missing."""


def test_a_time_is_seconds_or_nanoseconds():
    nanoseconds = [time_of(text) for text in ("12.5", "5", "1.5e0", "1403636579763555584", "x", "nan", "inf")]
    assert nanoseconds == [12_500_000_000, 5_000_000_000, 1_500_000_000, 1403636579763555584, None, None, None]


def _lines(form: str, scale: float = 1.0, *, mark: str = ".") -> str:
    return "\n".join(form.format(i=i, t=scale * t).replace(".", mark) for i, t in enumerate(TIMES))


@pytest.mark.parametrize(
    "content",
    [
        _lines("{t:.6f}"),
        "# time\n" + _lines("{t:.6f}"),
        "frame,timestamp\n" + _lines("{i},{t:.6f}"),
        "# frame, time [ms]\n" + _lines("{i}, {t:.3f}", 1e3),
        "index;t_us\n" + _lines("{i};{t:.0f}", 1e6),
        "Time (s);Frame\n" + _lines("{t:.4f};{i}", mark=","),  # a spreadsheet's, where decimals have commas
        "time\n" + _lines("{t:.5f}", mark=","),
        "# timestamp format v2\n" + _lines("{t:.0f}", 1e3),  # mkvextract
        "# timecode format v2\n" + _lines("{t:.6f}", 1e3),
        _lines("frame,{t:.6f}"),  # ffprobe
        "n\tpts_time\n" + _lines("{i}\t{t:.4f}"),
        "# taken at half past three, by hand\n" + _lines("{t:.6f}"),
        "#timestamp [ns],filename\n" + _lines("{t:.0f},{i}.png", 1e9),
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_files_of_times_say_what_their_numbers_are(tmp_path: Path, content: str, encoding: str):
    path = tmp_path / "cam0.csv"
    path.write_text(content, encoding=encoding)
    np.testing.assert_allclose(read_times(path).times(5, "5 frames") * 1e-9, TIMES, atol=0.5e-9)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (_lines("{i},{t:.6f}"), r"row 1: '0,2\.500000' holds several numbers that may be the time.*'frame,time'"),
        (_lines("{i} {t:.6f}"), "several numbers"),
        (_lines("{t:.6f}", mark=","), "several numbers.*decimal commas"),
        (_lines("{t:.6f}\t{i}\ta.png"), "several numbers"),
        (_lines("{t:.3f}", 1e3), r"10 s apart, read in s.*are the times in ms\? A first line '# time \[ms\]' says so"),
        (_lines("{t:.0f}", 1e6), r"1e\+04 s apart.*are the times in us\?"),
        (_lines("{t:.0f}", 1e9), r"1e\+07 s apart.*are the times in ns\?"),  # of a clock that began with the recording
        ("\n".join(f"{1.7e15 + 1e6 * t:.0f}" for t in TIMES), r"1e-05 s apart, read in ns.*are the times in us\?"),
        ("\n".join(f"{1.7e12 + 1e3 * t:.0f}" for t in TIMES), r"1e-08 s apart, read in ns.*are the times in ms\?"),
        ("time_s\n" + _lines("{t:.3f}", 1e3), r"are the times in ms\?"),
        ("frame,time\n" + _lines("{t:.6f}"), "row 2: '2.500000' has 1 columns; its header names 2"),
        ("time\n00:00:02.5\n", "row 2: '00:00:02.5' is no time"),
        ("2024-05-01T12:00:00\n", "row 1: .* is no time"),
        ("1.0,a.png\nnever,b.png", r"row 2: 'never,b\.png' is no time"),
        ("frame,date\n0,12\n", "row 1: 'frame,date' is no time"),
        (str(10**25), "has a time of .* ns, expected at most"),
    ],
)
def test_numbers_that_may_not_be_the_time_are_asked_for(tmp_path: Path, content: str, says: str):
    path = tmp_path / "cam0.txt"
    path.write_text(content)
    with pytest.raises(FileError, match=says):
        read_times(path).times(5, "5 frames")


@pytest.mark.parametrize("rate", [29.97, 59.94, 148.0, 239.76])
@pytest.mark.parametrize("tick_ms", [1.0, 1000 / 600])
def test_rounded_times_are_put_back_on_their_grid(rate: float, tick_ms: float):
    rng = np.random.default_rng(int(rate))
    shown = np.flatnonzero(rng.random(2000) > 0.1)
    t = 3.2 + shown / rate
    rounded = np.round(np.round(t * 1e3 / tick_ms) * tick_ms * 1e6).astype(np.int64)
    off = evened(rounded, tick_ms * 1e6) * 1e-9 - t
    assert np.abs(off).max() < 0.05e-3
    assert np.abs(rounded * 1e-9 - t).max() > 0.2e-3
    assert usual_rate(rounded) == pytest.approx(rate, rel=2e-2)


def test_times_that_are_on_no_grid_stay_as_they_are():
    rng = np.random.default_rng(0)
    t_ns = np.cumsum(rng.uniform(5e6, 9e6, 300)).astype(np.int64)
    assert evened(t_ns, 1e6) is t_ns
    assert evened(t_ns[:2], 1e6) is not None
    slow = np.arange(6) * 10**9  # whole seconds say nothing of what lies between
    assert evened(slow, 1e9) is slow
    check_rate(Path("a"), t_ns, unit="ns")


def test_an_hour_on_a_clock_that_drifts_is_no_grid():
    n = np.arange(500_000)
    t = n / 148 * (1 + 2e-9 * n)  # a part in a thousand over the hour
    rounded = np.round(t * 1e3).astype(np.int64) * 10**6
    assert np.abs(evened(rounded, 1e6) * 1e-9 - t).max() < 0.51e-3
