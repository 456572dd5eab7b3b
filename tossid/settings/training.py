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
    NonNegative,
    Positive,
    Seed,
    advanced,
)
from tossid.settings.limits import Gravity
from tossid.settings.objects import UnknownObjectSettings


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
    """start from corners, friction and (if learned) inertia that the seed draws (`tossid.models.random_start`)"""
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
    batch: Count = advanced(256)
    """transitions in one step of Adam"""
    threads: Count | None = advanced(None)
    """threads of rollouts, which share the tosses among them; none: one a core. The numbers do not depend on it"""
    rollout_epochs: Count = advanced(15)
    """most steps of a stage that minimises the error of open-loop predictions"""
    restart_corners: bool = advanced(True)
    """start from the corners that tosses show where they contradict the given ones (`tossid.training.restarts`)"""
