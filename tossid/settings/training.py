"""Settings of training: which model, from which tosses, for how long (`tossid.models`, `tossid.training`).

`ModelSettings` says what is learned and what is given. `VARIANTS` names the combinations that the papers compare.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

from tossid.settings.kinds import (
    Bounds,
    Checked,
    Count,
    Fraction,
    NonNegative,
    Positive,
    Seed,
    advanced,
    advanced_part,
)
from tossid.settings.limits import Gravity
from tossid.settings.objects import EvidenceSettings, UnknownObjectSettings


@dataclass(frozen=True, kw_only=True)
class ModelSettings(Checked):
    """What is learned and what is given."""

    name: str = "cn"
    """what this variant is called, in tables and files"""
    kind: str = "contactnets"
    """kind of model: contactnets, e2e, or one that was registered (tossid.models.register_model)"""
    learn_geometry: bool = True
    """learn where the corners are"""
    learn_friction: bool = True
    """learn Coulomb's friction"""
    learn_k_res: bool = False
    """learn an acceleration k_res beside the given continuous dynamics k_hat"""
    k_res_inputs: Literal["body", "world"] = "body"
    """what k_res sees. body: attitude, velocity and spin as the body feels them, so that it is the same everywhere;
    world: and position, heading and velocity in the world, for a field"""
    k_res_gravity: bool = True
    """k_res has a uniform vertical acceleration of its own, which nothing penalises"""
    learn_inertia: bool = False
    """learn inertia, centre of mass, and the ratios of the links' masses"""
    learn_com: bool = advanced(True)
    """learn the centre of mass where inertia is learned; false: it stays as it is given"""
    learn_contact_law: bool = False
    """learn stiffness, relaxation and cohesion of contact; from rollouts alone"""
    implicit: bool = True
    """learn contact by the implicit loss first; false: by prediction error alone"""
    together: bool = False
    """learn everything at once by the implicit loss, on all transitions; corners are never started again"""
    refine_geometry: bool = False
    """rollouts refine the corners, too"""
    gravity: Gravity = 9.81
    """downward acceleration of the given continuous dynamics [m/s²]"""
    hidden: Annotated[int, Bounds(low=1, high=1024)] = 16
    """width of the hidden layers (of k_res; of e2e's network)"""
    residual_weight: NonNegative = 1e-6
    """weight of the squared k_res in the loss, but for its uniform vertical part"""
    complementarity: NonNegative = 1.0
    """weight of impulses at a distance"""
    dissipation: NonNegative = 100.0
    """weight of friction that does not oppose sliding"""
    penetration: NonNegative = 0.1
    """weight of corners below the ground"""
    gap_scale: Positive = 1e-3
    """distance below which a gap counts quadratically [m]; the noise of the corners' heights"""
    horizons: tuple[Count, ...] = (20, 90)
    """frames after first contact of the rollouts that refine friction, contact law and inertia; with joints, of
    stretches from everywhere in a toss, half the first and then the first long; []: no such stages"""
    cone: Literal["exact", "polyhedral"] = "exact"
    """friction cone of rollouts; polyhedral: of eight directions, solved as a linear complementarity problem"""
    inertia: Literal["log_cholesky", "triangular", "direct"] = "log_cholesky"
    """parameterisation of a learned inertia; triangular: A^T A with A upper triangular"""
    random_start: bool = False
    """start from corners, friction and (if learned) inertia that the seed draws, as in StartSettings"""
    start_inertia: Positive = 1.0
    """inertia that training starts from, relative to the object's"""
    start_com: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """shift of the centre of mass (of the base) that training starts from [m]"""
    start_corners: NonNegative = 0.0
    """how far off the given corners are when training starts, along each axis, drawn by the seed [m]"""
    length_scale: Positive | Literal["auto"] = 1.0
    """recorded length per true length; auto: as training tosses at rest show it, where the object's size is stated"""
    velocity_lag: NonNegative | Literal["auto"] = "auto"
    """how much earlier recorded velocities are than their poses [s]; auto: as the training tosses' flight shows it"""
    inertia_weight: NonNegative = advanced(2e-4)
    """weight in the implicit loss of a tree's divergence from the given inertia [m²/s²]. Without it the loss prefers
    light links, which hardly constrain it: with real tosses a link went from 0.37 kg to 0.2 g. Rollouts have no such
    term"""
    substeps: Count = advanced(3)
    """steps of the simulator a frame, in training and in evaluation"""
    impact_parts: Count = advanced(8)
    """from 2 on, steps of rigid contact end where a corner strikes; 1: impacts happen where steps end"""


CN = ModelSettings(name="cn")
CNRP = replace(CN, name="cnrp", learn_k_res=True)
CNRPI = replace(CNRP, name="cnrpi", learn_inertia=True, learn_contact_law=True)
DIFFSIM = replace(CNRPI, name="diffsim", implicit=False, refine_geometry=True)
E2E = ModelSettings(
    name="e2e", kind="e2e", learn_geometry=False, learn_friction=False, implicit=False, hidden=128, horizons=()
)
CNRP_WORLD = replace(CNRP, name="cnrp_world", k_res_inputs="world", k_res_gravity=False, residual_weight=1e-7)
PAPER_CN = replace(
    CN,
    name="paper_cn",
    together=True,
    random_start=True,
    dissipation=1.0,
    penetration=1.0,
    horizons=(),
    cone="polyhedral",
)
PAPER_CNRP = replace(
    PAPER_CN, name="paper_cnrp", learn_k_res=True, k_res_inputs="world", k_res_gravity=False, residual_weight=5e-6
)
PAPER_CNRPI = replace(PAPER_CNRP, name="paper_cnrpi", learn_inertia=True, inertia="triangular")
VARIANTS = {
    variant.name: variant for variant in (CN, CNRP, CNRPI, DIFFSIM, E2E, CNRP_WORLD, PAPER_CN, PAPER_CNRP, PAPER_CNRPI)
}
"""The variants by name. cn: geometry and friction (ContactNets); cnrp: and k_res; cnrpi: and inertia with the centre of
mass, and the contact law; diffsim: what cnrpi learns, by prediction error alone; e2e: a network from state to next
velocity; cnrp_world: cnrp with a k_res that knows where the object is, and gravity in it like any other field;
paper_cn, paper_cnrp, paper_cnrpi: the same three as Bianchini and Posa have them, everything at once. `conf/model/`
shows the same."""


@dataclass(frozen=True, kw_only=True)
class TransitionSettings:
    """Which pairs of neighbouring frames may involve contact, and which surely do not."""

    contact_margin: Positive = 0.25
    """a transition may involve contact when a stated corner is, after it, lower than this share of the width"""
    flight_clearance: Positive = 0.1
    """it is in flight when every stated corner stays higher than this share of the width"""
    jointed_contact_margin: Positive = 0.4
    """`contact_margin` of objects with joints, whose stated geometry is less exact: the published elbow's corners stop
    up to 2 cm above the ground"""
    jointed_flight_clearance: Positive = 0.3
    """`flight_clearance` of objects with joints: with 1 cm the elbow seems to fall at 8.4 m/s², with 3 cm at 9.8"""
    outlier_deviations: Positive = 20.0
    """robust standard deviations (1.48 median absolute deviations) from the median flight by which a flight's
    acceleration may differ, along each axis; beyond, a hand or the ground had a part in it"""
    outlier_floor: Positive = 0.5
    """difference from the median flight that is accepted in any case [m/s²]: tosses without noise have no scatter"""


@dataclass(frozen=True, kw_only=True)
class RolloutSettings:
    """How open-loop prediction error is minimised (`tossid.training.rollouts`)."""

    epochs: Count = 15
    """most Gauss-Newton steps a stage"""
    huber: Positive = 0.1
    """error up to which the pseudo-Huber loss is quadratic [half widths, rad]"""
    difference: Positive = 0.015
    """step of the differences, in the parameters' own units of order one"""
    chaotic_share: Fraction = 0.2
    """share of the frames, those with the largest derivatives, that neither make a step nor judge it"""
    largest_step: Positive = 0.3
    """largest change of a parameter in one step, in its own unit"""
    least_gain: Positive = 2e-3
    """relative gain of a step below which the stage ends"""
    settling: Count = 6
    """most averaged steps, with which the last stage of a rigid body goes on where learned contact yields"""
    settling_many: Count = 4
    """the same of many tosses, whose differences go to one side: what is left open is less"""
    settled: Positive = 0.15
    """averaged step below which that stage ends, in standard errors (rms over the parameters)"""
    trials: Count = 10
    """dampings that a step tries before the stage ends"""
    damping: Positive = 1e-2
    """damping of Levenberg and Marquardt that a stage starts with, relative to the diagonal"""
    min_flight_frames: Count = 4
    """frames before first contact from which a first state is also estimated from the flight"""
    contact_times_ms: tuple[Positive, ...] = (0.5, 1.0, 2.0, 3.0, 5.0)
    """contact times of the starts that are compared where the contact law is learned [ms]"""
    dampings: tuple[Positive, ...] = (0.2, 0.4, 0.7, 1.5)
    """damping ratios of these starts"""
    simulator_step_ms: Positive = 1.7
    """time step of rollouts [ms]; damping within one step is numerical, so starts have that much more"""
    rigid_time_ms: Positive = 0.6
    """contact times up to which contact is rigid as far as a step of 1.7 ms can resolve [ms]"""
    raced_tosses: Count = 60
    """where there are twice as many tosses, starts of the contact law and of friction are first compared on so many of
    them and then on more, and steps take differences to one side unless there are joints"""
    race_margin: Positive = 2.0
    """standard errors by which a start must be worse than the best one on a share of the tosses to be compared on no
    more of them"""
    softer_share: Fraction = 0.97
    """share of rigid contact's loss that a softer start must stay below to be preferred: what a softer
    contact gains at a wrong inertia is the inertia's"""


@dataclass(frozen=True, kw_only=True)
class StartSettings:
    """Random starts of training (`tossid.training.starts`)."""

    ball: Positive = 0.2
    """radius of the ball in which corners lie evenly [m]"""
    offset_rel: Positive = 0.4
    """standard deviation of each coordinate of the other corners from the stated ones, in half widths; Pfrommer, Halm
    and Posa start so far off"""
    friction: tuple[Positive, Positive] = (0.05, 1.5)
    """range of friction"""
    inertia: tuple[Positive, Positive] = (0.25, 4.0)
    """range of inertia, relative to the stated one"""


@dataclass(frozen=True, kw_only=True)
class RestartSettings:
    """When a parameter is started again from other values (`tossid.training.restarts`)."""

    corners: Annotated[int, Bounds(low=0)] = 3
    """most times that corners which the tosses contradict are started again where the tosses show corners; 0: never"""
    gap_widths: tuple[Positive, ...] = (4.0, 2.0, 1.0)
    """multiples of the model's gap_scale with which the contact stage is gone through once corners were started again,
    each to the end of its training loss; (): not gone through again"""
    followed_to: Positive = 1e-7
    """relative decrease of the training loss from one epoch to the next, below which such a pass ends"""
    followed_loss: Positive = 1.1
    """ratio of the validation loss after these passes to the one before up to which they count"""
    frictions: tuple[Positive, ...] = (0.05, 0.15, 0.4, 1.0)
    """values of friction that are compared with the present one before a rollout stage"""
    friction_factors: tuple[Positive, ...] = (0.6, 0.75, 0.9, 1.1)
    """factors of the friction that steady sliding shows, which are compared with it before it is kept"""
    better_share: Fraction = 0.8
    """share of the present loss that another friction must stay below to be preferred"""
    friction_range: tuple[Positive, Positive] = (0.005, 5.0)
    """friction outside of which training is said not to have converged"""
    still_falling: Positive = 0.01
    """relative decrease of the validation loss over the last `patience` epochs, above which a stage that ended at its
    most epochs is said not to have converged"""
    evidence: EvidenceSettings = advanced_part(EvidenceSettings)
    """when tosses contradict corners"""


@dataclass(frozen=True, kw_only=True)
class IntervalSettings:
    """Intervals of what rollouts determine (`tossid.training.uncertainty`)."""

    weak_friction: Positive = 0.05
    """half width of friction's interval beyond which the tosses do not determine it"""
    weak_com: Positive = 5e-3
    """the same of a centre of mass [m]"""
    weak_contact_rel: Positive = 0.5
    """the same of stiffness, relaxation and cohesion, relative to the value"""
    weak_inertia_rel: Positive = 0.25
    """the same of moments of inertia and masses, relative to the value"""


@dataclass(frozen=True, kw_only=True)
class TrainSettings(Checked):
    """Fit a model to a dataset."""

    model: ModelSettings = field(default=CNRPI)
    """the model"""
    object: UnknownObjectSettings | None = None
    """unknown: start from the shape and the centre of mass that the training tosses show, whatever object the dataset
    states; null: start from that object, or from unknown where it states none"""
    tosses: Count | None = None
    """learn from so many of the training tosses, and stop by at most as many others, drawn by the seed; null: all"""
    seed: Seed = 0
    """seed of the first weights of k_res"""
    epochs: Count = 60
    """most epochs a stage"""
    patience: Count = 8
    """epochs without a better validation loss before a stage ends"""
    optimizer: Literal["lbfgs", "adam"] = "lbfgs"
    """of the implicit loss"""
    learning_rate: Positive = 1e-3
    """Adam's"""
    least_improvement: Positive = advanced(1e-4)
    """relative decrease of the validation loss that counts as better"""
    batch: Count = advanced(256)
    """transitions in one step of Adam"""
    lbfgs_history: Count = advanced(20)
    """steps that L-BFGS remembers"""
    lbfgs_evaluations: Count = advanced(25)
    """most passes through the data of one line search"""
    threads: Count | None = advanced(None)
    """threads of rollouts, which share the tosses among them; none: one a core. The numbers do not depend on it"""
    transitions: TransitionSettings = advanced_part(TransitionSettings)
    """which pairs of frames may involve contact"""
    rollouts: RolloutSettings = advanced_part(RolloutSettings)
    """how prediction error is minimised"""
    restarts: RestartSettings = advanced_part(RestartSettings)
    """when a parameter is started again from other values"""
    intervals: IntervalSettings = advanced_part(IntervalSettings)
    """intervals of the learned parameters"""
