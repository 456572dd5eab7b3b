"""What can be diagnosed: each kind of simulator, read as a world of tossid's own.

`diagnose` takes whatever a registered reader accepts. A new kind of simulator is one function here, or anywhere else,
under `@reader(KIND, ACCEPTS)`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from tossid.diagnosis.inference.hypothesis import COULOMB, RELAXED, ROUTH, ContactLaw
from tossid.diagnosis.likelihood.engine_discrepancy import Engine
from tossid.diagnosis.likelihood.simulator_process import BatchFunction, FromFile, SimulatorProcess
from tossid.diagnosis.likelihood.step_changes import State
from tossid.diagnosis.likelihood.users_world import UsersWorld
from tossid.diagnosis.likelihood.windows import steps_of
from tossid.diagnosis.patch.make import patched_model
from tossid.errors import InputError, brief
from tossid.objects import ObjectModel, load_object, need_stated
from tossid.objects.files.friction import colliding_geoms, combined_words, contact_friction
from tossid.objects.files.model_file import read_model_file
from tossid.physics.effects import RecordingErrors, World
from tossid.physics.forces import Forces
from tossid.rotations import geodesic_angle, quat_rotate
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.types import Toss, frame_time

if TYPE_CHECKING:
    from tossid.models.protocol import DynamicsModel

STILL = 10.0
"""Standard deviations of poses within which nothing moves in a toss."""
SIZE_RATIO = 1.6
"""Ratio of the sizes of two objects beyond which one is no wrong statement of the other."""
FARTHEST = 1e3
"""Distance from the origin beyond which a simulated toss has diverged [m]."""
MOST_DIVERGED = 0.1
"""Share of tosses on which a simulator may diverge."""
MOST_LOST = 0.2
"""Share of the changes of velocity of a user's simulator that a stop at each frame may change. Beyond it, effects are
added to whole motions."""


@dataclass(frozen=True)
class Simulator:
    """A simulator to be diagnosed.

    Attributes:
        kind: What it is: "nominal", "run", "mjcf", "python" or "world".
        about: The simulator in words.
        world: The simulator as a world of tossid's own, to which effects are added.
        contact: Laws of contact that tosses may follow, its own first; those of rigid contact if there are none here.
        mjcf: The user's own MJCF file, which the patch changes.
        run: The tracker's id of the training that the model comes from.
        reads: What the engine makes of what the user's file states, in words.
    """

    kind: str
    about: str
    world: World
    contact: tuple[ContactLaw, ...] = ()
    mjcf: Path | None = None
    run: str | None = None
    reads: str = ""

    @property
    def law(self) -> ContactLaw:
        """Its own law of contact."""
        return (self.contact or _rigid_laws(self.world))[0]

    @property
    def laws(self) -> tuple[ContactLaw, ...]:
        """Others that tosses may follow."""
        return (self.contact or _rigid_laws(self.world))[1:]

    @property
    def frames(self) -> int | None:
        """How many frames a user's own simulator has been asked for; None of another."""
        return self.world.motions.process.frames if isinstance(self.world, UsersWorld) else None

    def as_json(self) -> dict[str, Any]:
        """gap.json's "simulator"."""
        return {"sim": self.kind, "about": self.about, "run": self.run, "reads": self.reads}


def _rigid_laws(world: World) -> tuple[ContactLaw, ...]:
    """Laws of rigid contact, that of a world first."""
    like = RELAXED if world.law.lifting > 0 else ROUTH if world.law.impulse_parts > 1 else COULOMB
    own = replace(like, lifting=world.law.lifting, impulse_parts=world.law.impulse_parts)
    return own, *(law for law in (COULOMB, ROUTH, RELAXED) if law is not like)


Reader = Callable[[Any, ObjectModel], Simulator]
"""(what the caller gave, the dataset's object) -> the simulator."""
_READERS: dict[str, tuple[Callable[[Any], bool], Reader]] = {}


def reader(kind: str, accepts: Callable[[Any], bool]) -> Callable[[Reader], Reader]:
    """A decorator that registers how a kind of simulator is read.

    Args:
        kind: The kind's name.
        accepts: Whether what the caller gave is of this kind.
    """

    def register(read: Reader) -> Reader:
        _READERS[kind] = accepts, read
        return read

    return register


def read_simulator(given: Any, recorded: ObjectModel) -> Simulator:
    """The simulator that a caller means.

    Args:
        given: A `Simulator`, or anything that a registered reader accepts: "nominal", a trained model, the path of an
            MJCF file, a `World`.
        recorded: The dataset's object.

    Raises:
        InputError: No reader accepts it, or it cannot be used.
        FileError, ObjectError: A file cannot be read.
    """
    if isinstance(given, Simulator):
        return given
    for accepts, read in _READERS.values():
        if accepts(given):
            return read(given, recorded)
    raise InputError(
        f"{brief(given)} is no simulator; expected 'nominal', a trained model, the path of an MJCF file, a World or a "
        "function f(q0, v0, n_steps, dt) -> (q, v)"
    )


@reader("nominal", lambda given: isinstance(given, str) and given == "nominal")
def _nominal(given: Any, recorded: ObjectModel) -> Simulator:
    return nominal(recorded)


@reader("world", lambda given: isinstance(given, World))
def _world(given: Any, recorded: ObjectModel) -> Simulator:
    return Simulator("world", f"a world with '{given.object.name}'", given)


@reader("run", lambda given: hasattr(_model_in(given), "learned_object"))
def _trained(given: Any, recorded: ObjectModel) -> Simulator:
    return Simulator("run", "the trained model", world_of_model(_model_in(given)))


@reader("mjcf", lambda given: isinstance(given, (str, Path)))
def _mjcf(given: Any, recorded: ObjectModel) -> Simulator:
    path = Path(given)
    world, model = world_of_mjcf(path, width=recorded.width if recorded.is_stated else None)
    grounds, own_geoms = colliding_geoms(model)
    reads = combined_words(model, grounds[0], own_geoms[0])
    own = replace(RELAXED, name="own", engine=Engine(partial(patched_model, mjcf=path)))
    return Simulator("mjcf", f"the MuJoCo model {path}", world, (own, COULOMB, ROUTH, RELAXED), path, reads=reads)


@reader("python", lambda given: callable(given) and not hasattr(_model_in(given), "learned_object"))
def _function(given: Any, recorded: ObjectModel) -> Simulator:
    name = getattr(given, "__qualname__", type(given).__qualname__)
    return users_simulator(given, recorded, about=f"the simulator {name}")


def users_simulator(source: FromFile | BatchFunction, recorded: ObjectModel, *, about: str) -> Simulator:
    """A user's own simulator, to whose predictions effects are added as changes.

    A change is what an effect does to the dataset's object in tossid's own simulator.

    Args:
        source: The function f(q0, v0, n_steps, dt) -> (q, v), or where it is.
        recorded: The dataset's object.
        about: The simulator in words.

    Raises:
        InputError: Nothing is stated of the object.
    """
    need_stated(recorded, "a simulator in Python (sim=python)")
    process = SimulatorProcess(source, about=about, seconds=DiagnoseSettings().simulator_seconds)
    own = ContactLaw("own", engine=Engine(none=True))
    return Simulator("python", about, UsersWorld.of(World(recorded), process), (own,))


def _model_in(given: Any) -> Any:
    """The model of what a training returns, or the model itself."""
    return getattr(given, "model", given)


def nominal(recorded: ObjectModel, **changes: Any) -> Simulator:
    """The dataset's object as it is stated, in tossid's own rigid contact.

    Args:
        recorded: The dataset's object.
        changes: Of the world, such as `gravity`.

    Raises:
        InputError: Nothing is stated of the object.
    """
    need_stated(recorded, "the nominal simulator (sim=nominal)")
    return Simulator("nominal", f"the stated '{recorded.name}', rigid", World(recorded, **changes))


def world_of_model(model: DynamicsModel) -> World:
    """The world of a trained model: what it has learned, and the rest as given.

    Args:
        model: Of an object with contact.

    Raises:
        InputError: The model has no object (e2e).
    """
    mechanics = model.mechanics()
    if mechanics is None:
        raise InputError("a network (e2e) has no object and no contact that could be diagnosed; name another run")
    return World(
        mechanics.object,
        gravity=mechanics.gravity,
        recording=RecordingErrors(length_scale=model.measurement.length_scale),
        k_res=mechanics.k_res,
    )


def world_of_mjcf(path: Path, *, width: float | None) -> tuple[World, mujoco.MjModel]:
    """The world of a user's MuJoCo model with contact as if it were rigid, and the model itself.

    Args:
        path: The MJCF file: one free body, and the ground as a plane.
        width: Of the dataset's object [m], to which errors refer; None for the file's own.

    Raises:
        FileError, ObjectError: The file cannot be read, or holds no single free body.
        InputError: It has no ground that is a plane, or several frictions with it.
    """
    m = read_model_file(path).compiled()
    grounds, own = colliding_geoms(m)
    if len(grounds) != 1 or m.geom_type[grounds[0]] != mujoco.mjtGeom.mjGEOM_PLANE:
        raise InputError(f"{path}: has {len(grounds)} geoms to land on, expected one: the ground, a plane")
    ground = grounds[0]
    frictions = sorted({contact_friction(m, ground, geom) for geom in own})
    words = " and ".join(f"{value:g}" for value in frictions)
    if len(frictions) > 1:
        raise InputError(f"{path}: its geoms meet the ground with friction {words}, expected one of the whole object")
    given = load_object(path, width=width, friction=next(iter(frictions), None))
    normal = quat_rotate(m.geom_quat[ground], np.array([0.0, 0.0, 1.0]))
    g, mass = m.opt.gravity, float(given.mass.sum())
    world = World(
        given,
        gravity=float(-g[2]),
        forces=Forces(x=float(mass * g[0]), y=float(mass * g[1])),
        ground_height=float(m.geom_pos[ground] @ normal),
        ground_tilt=_tilt_of(normal),
    )
    return world, m


def _tilt_of(normal: np.ndarray) -> tuple[float, float]:
    """Rotation vector (about x, y) that takes the vertical to a plane's normal."""
    axis = np.array([-normal[1], normal[0]])
    size = float(np.linalg.norm(axis))
    if size < 1e-12:
        return 0.0, 0.0
    angle = float(np.arctan2(size, normal[2]))
    return float(axis[0] / size * angle), float(axis[1] / size * angle)


# ---------------------------------------------------------------- what is refused


def check_same_object(world: World, recorded: ObjectModel, *, where: str) -> None:
    """Refuse a simulator of another object than the one that was tossed.

    Args:
        world: The simulator's.
        recorded: The dataset's object.
        where: The dataset in words, for the error.

    Raises:
        InputError: It has other joints, or another size.
    """
    given = world.object
    if given.n_joints != recorded.n_joints:
        raise InputError(
            f"{where}: tosses of '{recorded.name}' with {recorded.n_joints} joints, the simulator's '{given.name}' "
            f"has {given.n_joints}; both must be of the same object"
        )
    ratio = np.ptp(given.drawn.corner_pos, axis=0) / np.ptp(recorded.drawn.corner_pos, axis=0)
    if (np.maximum(ratio, 1 / ratio) > SIZE_RATIO).any():
        sizes = [" x ".join(f"{1e3 * x:.0f}" for x in np.ptp(o.drawn.corner_pos, axis=0)) for o in (given, recorded)]
        raise InputError(
            f"{where}: tosses of '{recorded.name}' ({sizes[1]} mm), the simulator's '{given.name}' measures "
            f"{sizes[0]} mm; both must be of the same object"
        )


def checked(simulator: Simulator, tosses: Sequence[Toss], settings: DiagnoseSettings) -> tuple[Simulator, list[str]]:
    """A simulator that has been run from tosses' first states to their ends, and remarks on how it did.

    A user's own comes back with the contact by which effects change it.

    Args:
        simulator: What is diagnosed.
        tosses: As recorded.
        settings: How finely is simulated, and how long a user's own may take.

    Raises:
        InputError: It diverges on more than a few of the tosses.
    """
    world, dt, n, remarks = simulator.world, frame_time(tosses), len(tosses), []
    if isinstance(world, UsersWorld):
        world.motions.process.seconds = settings.simulator_seconds
    first = State(np.stack([toss.q[0] for toss in tosses]), np.stack([toss.v[0] for toss in tosses]))
    steps = np.array([toss.ticks(dt)[-1] for toss in tosses])
    how = steps_of(world, settings.likelihood.simulation)
    run = world.roll_out(first.q, first.v, n_steps=steps, dt=dt, **how, n_threads=settings.n_threads)
    far = np.abs(np.where(np.isfinite(run[..., :3]), run[..., :3], np.inf)).max(axis=(1, 2))
    lost = [toss.name for toss, size in zip(tosses, far, strict=True) if not size < FARTHEST]
    if len(lost) > MOST_DIVERGED * n:
        raise InputError(
            f"{simulator.about}: the simulator diverges (NaN, or farther than {FARTHEST:g} m) on {len(lost)} of {n} "
            f"tosses, the first of them '{lost[0]}'"
        )
    if lost:
        remarks.append(f"The simulator diverges on {len(lost)} of {n} tosses: {', '.join(lost)}.")
    if not isinstance(world, UsersWorld):
        return simulator, remarks
    world.check_clock(first, dt, simulator.about)
    ready = world.prepared(first, steps, dt, most_lost=MOST_LOST, **how)
    if not ready.by_frame:
        remarks.append(
            "The simulator does not go on from a state as it does without a stop, so it has a state beside positions "
            "and velocities, or returns other velocities than its own. Effects are added to its whole motions, which "
            "is exact in flight, and poor in contact."
        )
    return replace(simulator, world=ready), remarks


def moves(toss: Toss) -> bool:
    """Whether anything moves in a toss: away from its first pose by much more than the noise of its poses.

    Args:
        toss: As recorded.
    """
    std = np.sqrt(np.median(np.einsum("nii->ni", toss.measured[1]), axis=0))
    far = np.linalg.norm(toss.q[:, :3] - toss.q[0, :3], axis=1).max()
    turned = geodesic_angle(toss.q[:, 3:7], toss.q[0, 3:7]).max()
    return bool(far > STILL * max(std[:3].max(), 1e-4) or turned > STILL * max(std[3:6].max(), 1e-3))
