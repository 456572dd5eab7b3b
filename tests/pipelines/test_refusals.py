"""Calls and files that are refused: one line that names what is wrong, exit code 2, and nothing is left or run."""

from __future__ import annotations

import os
import shlex
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import torch

from pipelines.cli import app
from tests.pipelines.conftest import MODEL, USER, one_line
from tests.store.makers import make_dataset
from tests.vision.bags import CAMERAS
from tests.vision.films import write_recording
from tossid.models import TrainedModel, build_model, variant
from tossid.objects import load_object
from tossid.settings.training import TrainSettings
from tossid.store import Dataset, read_dataset, write_dataset
from tossid.types import Phase, PoseTrack
from tossid.vision.recordings.npz import write_tracks
from tossid.vision.setup.faces import default_tags
from tossid.vision.setup.layout import layout_of

BRICK = "box=[0.2,0.1,0.06] mass=0.8 com=[0.01,0,0]"
DAMAGED = {
    "frame": ("*.jpg", "no image", ".jpg"),
    "layout": ("tagslam.yaml", "bodies: [", "tagslam.yaml"),
    "cameras": ("cameras.yaml", "{}", "cameras.yaml"),
    "object": ("object.yaml", "name: 3\nmass: 2\n", "object.yaml"),
}
"""Files of a film, what stands in one of them instead, and what is said of it."""

ASKS = {
    "path": ("/etc/hostname", "", "it names '/etc/hostname', expected a file in its own folder"),
    "fifo": ("pipe.stl", "", "which is not a regular file"),
    "link": ("link.stl", "", "which links to a place outside its own folder"),
    "include": ("object.xml", '<include file="{outside}/nothing.xml"/>', "expected a file in its own folder"),
    "device": ("object.xml", '<asset><mesh file="/dev/zero"/></asset>', "'/dev/zero', expected a file"),
    "plugin": ("object.xml", '<extension><plugin plugin="mujoco.sdf"/></extension>', "element <extension>"),
}
"""What a recording's object asks for that no file from outside may: its path, the model's head; what is said of it."""

REFUSED: dict[str, dict[str, str | tuple[str, ...]]] = {
    "": {
        "ingset": "Did you mean 'ingest'?",
        "--version --quiet": "It stands after one: tossid COMMAND --quiet.",
        "-q": "It stands after one: tossid COMMAND -q.",
        "--versoin": "--version",
        "zzz": "audit, detect,",
    },
    "info": {
        "": "FILE",
        "nowhere.h5": "nowhere.h5: no such file",
        "narrow.txt": "has 7 columns, expected rows of 'timestamp tx",
        "nothing.xml": "expected a dataset",
        "thesis": "a folder without",
        "tosses/tosses.h5 --figure a.pdf": "--figure expects a file that ends with .png",
        "two.h5 --figure a.png": "its order of recording was not looked at",
    }
    | {f"asks_{name}": (f"asks_{name}/object.", says) for name, (_, _, says) in ASKS.items()},
    "ingest": {
        "": "no recording here",
        "soruce=tum": "Did you mean 'source'?",
        "--seed 3": "seed=…",
        "--jsn": "--json",
        "source=tum": "source.path: is needed",
        "source=tum source.path=nowhere": "nowhere: no such file or folder; source.path names",
        "source=tum source.path=short_row out=notes.txt": "Did you mean 'notes.h5'?",
        "source.path=thesis out=a.h5": "thesis: has no cameras.yaml and no tagslam.yaml; a recording is its images or",
        "source=contactnets source.path=nan": ("0.pt", "7", "NaN"),
        "source=contactnets source.path=hostile": "0.pt",
    }
    | {f"source.path=film_{name} out=a.h5": says for name, (_, _, says) in DAMAGED.items()},
    "detect": {
        "recordings=none/*": "nothing fits 'none/*'",
        "recordings=raw/* threads=2": "threads: is for one recording",
        "recordings=*/a": "several are named 'a'",
        "recording=fifo": "fifo/cameras.yaml",
    },
    "segment recording=film": {
        "poses=none.npz": "none.npz: no such file; 'tossid track' makes it",
        "poses=two.npz": "two.npz: holds 2 tracks, expected one",
    },
    "train": {
        "model=cnrip": "there is no 'cnrip' in conf/model",
        "model.gravity=-1": "model.gravity: -1 is out of range",
        "data=nowhere.h5": "nowhere.h5: no such dataset",
        "data=film": "is a folder, and no dataset (.h5); 'tossid ingest source.path=film' makes one of a recording",
        "data=short_row": "'tossid ingest source=tum source.path=short_row' makes one of the poses in it",
        "data=tosses tosses=99": "tosses=99: the dataset has 5 training tosses",
        "data=cut.h5": "cut.h5",
        "data=impossible.h5": ("impossible.h5, /tosses/toss_0000", "frame 3: v is 1e+300, expected at most 1e+06"),
        "data=untrained.h5": "no tosses in split 'train'",
        "data=reaching.h5": "reaching.h5: /object: it names another file or folder",
    },
    "evaluate": {
        "run=nothing-of-the-kind": "no such run",
        "run=tosses/": "is no run",
        "run=cut_run/ data=tosses": "checkpoint.pt",
        "run=hostile/ data=tosses": "checkpoint.pt",
        "run=reaching data=tosses": "checkpoint.pt: a checkpoint that cannot be used: it names another file or folder",
        "--swep gravity": "--sweep",
        "--sweep": "requires an argument",
        "--sweep gravty": "Did you mean 'gravity'?",
        "--sweep gravity data=nowhere.h5": "nowhere.h5: no such dataset",
        "--sweep gravity launcher=dask": "launcher.address: is needed",
        "--sweep gravity launcher=slurm": "launcher.interface: is needed",
    },
    "evaluate data=tosses --sweep gravity": {
        "run=abc": "run: a study trains its own models",
        "sweep=gravity": "is given twice",
        "sweep.key=model.gravty": "Did you mean 'model.gravity'?",
        "sweep.key=seed": "sweep.key: seed is set by the study itself",
        "sweep.values=[]": "sweep.values: is empty",
        "sweep.values=[1,-1]": "model.gravity: -1 is out of range",
        "sweep.models=[cnx]": "there is no 'cnx' in conf/model",
        "\"sweep.models=['cn optimiser=adam']\"": "Did you mean 'optimizer'?",
        "\"sweep.train=['data=x.h5']\"": "sweep.train: data is set by the study itself",
        "sweep.seeds=[1,1]": "names one twice",
    },
    "diagnose": {
        "sim=nominl": "Did you mean 'nominal'?",
        "sim=mjcf": "sim.path: is needed",
        "data=two.h5": "has 2 tosses; a diagnosis needs at least 3",
        "data=brief.h5": "has 0 tosses that serve (10 of 10 are shorter than 11 frames)",
        "data=still.h5": "has 0 tosses that serve (in 10 of 10 nothing moves)",
        "data=elbow.h5 sim=mjcf sim.path=mine.xml": ("with 1 joints", "same object"),
    },
    "diagnose data=tosses": {
        "without=[fricton]": "Did you mean 'friction'?",
        "split=test": "test split: has 2 tosses; a diagnosis needs",
        "sim=mjcf sim.path=none.xml": "no such object file",
        "sim=mjcf sim.path=longer.xml": "105 x 105 x 105 mm",
        "sim=mjcf sim.path=round_ground.xml": "a plane",
        "sim=mjcf sim.path=nothing.xml": "nothing.xml: ",
        "sim=python sim.path=none.py": "sim.path: there is no file none.py",
        "sim=python sim.path=mine.py sim.function=absent": "has no function 'absent'",
        "sim=python sim.path=mine.py sim.function=dying": "dying of mine.py: its process ended (exit status 7)",
    },
    "synthesize": {
        "frames=false tosses=3 out=o effects={com_offset:{z_m:1}}": ("effects.com_offset.z_m: ", "-0.04 to 0.04"),
        "frames=false tosses=3 out=o effects={com_offset:3}": "effects.com_offset: ",
        "frames=false tosses=3 out=o object=custom object.name=a object.path=heavy.xml": "mass",
        "frames=false tosses=3 out=thesis": "thesis: holds files",
        "object.tags=null tosses=1": "object.tags: 'cube' has no tags",
    },
    "new-object out=new": {
        f"name=../evil {BRICK}": "name: '../evil' will not do",
        f"name=a {BRICK} tag_size=0.06": "tag_size: 0.06 leaves no white margin on the smallest face; expected at most",
        f"name=a {BRICK} first_id=582": "first_id: 582 is out of range",
        "name=a box=[0.2,0.1] mass=0.8": "box: has 2 values",
        "name=a box=[120,100,80] mass=1": "expected metres: [0.12,0.1,0.08] if these are mm",
    },
    "export": {
        "format=urdf out=cube.xml": "does not end in .urdf",
        "format=urdf out=a/b/odd.urdf run=odd": "'../x'",
    },
    "view": {
        "recording=film out=film.rrb": "out: 'film.rrb' does not end in .rrd",
        "recording=film sheet=film.jpg": "does not end in .png",
        "data=x.h5 sheet=film.png": "contact sheet of a recording",
        "gap=x run=y": "one of them is shown at a time",
        "recording=film sheet=s.png start_s=100": "has nothing from start_s=100 on",
        "recording=film sheet=s.png poses=none.npz": "none.npz: no such file; 'tossid track' makes it",
    },
}

SIMULATORS = """
def dying(q0, v0, n_steps, dt):
    raise SystemExit(7)
"""
OBJECT = "name: box\npath: {path}\nfriction: 0.2\nrestitution: 0.0\nwidth: null\ntags: null\n"
ODD = """<robot name="odd"><link name="../x"><inertial><origin xyz="0 0 0"/><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link></robot>"""


class Bomb:
    """What a hostile file would run."""

    def __reduce__(self) -> Any:
        return os.mkdir, ("exploded",)


def _write_files(made: Path, film: Path) -> None:
    """Everything that the calls above name, in the working folder."""
    shutil.copytree(made, ".", dirs_exist_ok=True)
    shutil.copytree(film / "film", "film")
    for folder in ("raw/a", "more/a", "thesis", "short_row", "cut_run", "nan", "hostile"):
        Path(folder).mkdir(parents=True)
    Path("thesis/thesis.tex").write_text("years of work")
    _write_objects()
    _write_published_tosses()
    _write_datasets(read_dataset(Path("tosses/tosses.h5")))
    _write_recordings()
    for name, damage in DAMAGED.items():
        shutil.copytree("film", f"film_{name}")
        file = next(Path(f"film_{name}").rglob(damage[0]))
        file.write_text(damage[1])
    _write_runs(next(Path("outputs/train").glob("*/checkpoint.pt")))


def _write_objects() -> None:
    Path("mine.xml").write_text(USER)
    Path("longer.xml").write_text(USER.replace("0.0524 0.0524 0.0524", "0.2 0.05 0.05"))
    Path("round_ground.xml").write_text(
        USER.replace('type="plane" size="5 5 .1"', 'type="sphere" size="5" pos="0 0 -5"')
    )
    Path("nothing.xml").write_text("<mujoco><nothing/></mujoco>")
    Path("mine.py").write_text(SIMULATORS)
    inertial = '<freejoint/><inertial pos="0 0 0" mass="1e300" diaginertia="1 1 1"/>'
    Path("heavy.xml").write_text(MODEL.format(head="").replace("<freejoint/>", inertial))


def _write_published_tosses() -> None:
    rows = [f"{0.01 * i:.2f} 0 0 {1 - 0.01 * i} 0 0 0 1" for i in range(20)]
    rows[7] = rows[7].rpartition(" ")[0]
    Path("short_row/a.txt").write_text("\n".join(rows))
    np.savetxt("narrow.txt", np.zeros((5, 7)))
    at_rest = np.tile([0.0, 0, 0, 1, 0, 0, 0], (3, 1))
    write_tracks([PoseTrack(name, np.arange(3.0), at_rest) for name in ("a", "b")], Path("two.npz"))
    toss = torch.zeros(1, 40, 19, dtype=torch.float64)
    toss[0, :, 2], toss[0, :, 3] = 3 - 0.05 * torch.arange(40), 1.0
    toss[0, 7, 0] = np.nan
    torch.save(toss, "nan/0.pt")
    for file in ("0.pt", "checkpoint.pt"):
        torch.save({"schema": Bomb()}, f"hostile/{file}")
    Path("hostile/config.yaml").write_text("{}")


def _write_datasets(tosses: Dataset) -> None:
    whole = Path("tosses/tosses.h5").read_bytes()
    Path("cut.h5").write_bytes(whole[: len(whole) // 2])
    for name, changed in (
        ("untrained", [replace(toss, split="test") for toss in tosses.tosses]),
        ("two", tosses.tosses[:2]),
        ("brief", [toss.frames(slice(0, 5)) for toss in tosses.tosses]),
        ("still", [
            replace(toss, q=toss.q[[0] * len(toss)], v=0 * toss.v, phase=np.full_like(toss.phase, Phase.REST))
            for toss in tosses.tosses
        ]),
    ):  # fmt: skip
        write_dataset(replace(tosses, tosses=tuple(changed), order=None), Path(f"{name}.h5"))
    write_dataset(make_dataset(load_object("elbow")), Path("elbow.h5"))
    write_dataset(make_dataset(load_object("cube")), Path("impossible.h5"))
    with h5py.File("impossible.h5", "a") as file:
        file["tosses/toss_0000/v"][3, 0] = 1e300
    write_dataset(make_dataset(load_object("cube")), Path("reaching.h5"))
    with h5py.File("reaching.h5", "a") as file:
        del file["object/mjcf"]
        file["object/mjcf"] = np.frombuffer(_reaching().encode(), dtype="|u1")


def _reaching() -> str:
    """A model that includes a file from outside its own folder."""
    return MODEL.format(head=f'<include file="{Path("nothing.xml").absolute()}"/>')


def _write_recordings() -> None:
    """Recordings of one empty frame whose object reaches outside its folder, or whose set-up is a pipe."""
    cube = load_object("cube")
    layout = layout_of(cube.with_changes(tags=default_tags(cube)))
    for name in ("fifo", *(f"asks_{each}" for each in ASKS)):
        folder = Path(name)
        write_recording(folder, CAMERAS[:1], layout, ())
        (folder / "frames" / "left" / "1.png").write_bytes(b"")
    Path("fifo/cameras.yaml").unlink()
    os.mkfifo("fifo/cameras.yaml")
    for name, (path, head, _) in ASKS.items():
        folder = Path(f"asks_{name}")
        os.mkfifo(folder / "pipe.stl")
        (folder / "link.stl").symlink_to(Path("mine.xml").absolute())
        (folder / "object.yaml").write_text(OBJECT.format(path=path))
        (folder / "object.xml").write_text(MODEL.format(head=head.format(outside=Path.cwd())))


def _write_runs(checkpoint: Path) -> None:
    shutil.copytree(checkpoint.parent, "reaching")
    content = torch.load(checkpoint, weights_only=True)
    content["object"]["mjcf"] = _reaching()
    torch.save(content, "reaching/checkpoint.pt")
    Path("cut_run/checkpoint.pt").write_bytes(checkpoint.read_bytes()[:2000])
    Path("cut_run/config.yaml").write_text("{}")
    Path("odd.urdf").write_text(ODD)
    shutil.copytree(checkpoint.parent, "odd")
    settings = TrainSettings(model=variant("cn"))
    TrainedModel(build_model(settings.model, load_object(Path("odd.urdf"))), settings, {}).save(
        Path("odd/checkpoint.pt")
    )


@pytest.fixture(scope="module")
def workshop(made: Path, film: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The working folder: a project with a finished training, and everything that the calls name."""
    folder = tmp_path_factory.mktemp("workshop")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.delenv("MLFLOW_TRACKING_URI", raising=False)
        _write_files(made, film)
        yield folder


def _contents(folder: Path) -> dict[Path, int]:
    """Every file but the store of runs, which SQLite touches to read it, and what a hostile file would make."""
    found = {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}
    kept = {path: time for path, time in found.items() if not path.name.startswith("mlflow.db")}
    return kept | dict.fromkeys(folder.rglob("exploded"), 0)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        pytest.param(f"{command} {keys}", says, id=f"{command} {keys}")
        for command in REFUSED
        for keys, says in REFUSED[command].items()
    ],
)
def test_a_refusal_is_one_line_and_leaves_nothing(
    workshop: Path, capfd: pytest.CaptureFixture[str], call: str, says: str | tuple[str, ...]
) -> None:
    before = _contents(workshop)
    capfd.readouterr()
    assert app.run(shlex.split(call) + ["--quiet"] * call.startswith(("info", "ingest"))) == 2
    out, err = capfd.readouterr()
    assert out == ""
    for words in (says,) if isinstance(says, str) else says:
        assert words in one_line(err)
    assert _contents(workshop) == before


def test_a_run_is_asked_for_where_there_is_none(project: Path, made: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert app.run(["diagnose", f"data={made / 'tosses'}", "sim=run"]) == 2
    assert "no finished run yet" in one_line(capfd.readouterr().err)
