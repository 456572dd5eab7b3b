"""Which way friction of an impact points: against the slip after it, or against the slip as it turns meanwhile.

    python -m pipelines.tools.experiments.by_hand.impact_laws FILE.h5 [--split train]
                                                              [--effects '{"com_offset": {"z_m": 0.0055}}']

An impact on a lone corner between two flights gives the jumps of velocity and spin (`localisation.witnesses`). Each law
predicts them from the velocities before. Inertia about each axis, restitution and friction are fitted to all impacts
for each law (Student's weights by an arctangent), so that both have the same number of values. The table has what they
leave. The last row says in how many tosses Routh's law leaves less, with the p-value of signed ranks over tosses.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import wilcoxon

from pipelines.tools.experiments.by_hand.given import arguments, asked
from tossid.diagnosis.localisation.witnesses import Impacts, lone_impacts
from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.rotations import quat_to_matrix, skew

Array = NDArray[np.float64]
LAWS = {"after the impact": 1, "as it turns (Routh)": 64}
"""Parts in which an impact's impulse is found."""
SPEED, SPIN = 0.01, 0.15
"""Sizes by which jumps of velocity [m/s] and spin [rad/s] are compared."""
TURNS = 60
"""Most corrections of the direction of slip within a part."""
CLOSE = 1e-6
"""Correction at which they end [rad]."""
FEWEST = 8
"""Impacts to which a law is fitted."""


def impulses(K: Array, before: Array, *, mu: float, restitution: float, parts: int) -> Array:
    """(n, 3) impulses of impacts at one point each [N s]: friction in each part is against the slip at its end.

    Args:
        K: (n, 3, 3) velocity there by an impulse there [1/kg].
        before: (n, 3) velocity there before, z normal [m/s].
        mu: Friction.
        restitution: Newton's coefficient.
        parts: 1 for the whole impulse at once.
    """
    out, v = np.zeros_like(before), before.copy()
    for part in range(1, parts + 1):
        wanted = v.copy()
        wanted[:, 2] -= before[:, 2] * (1 - (1 + restitution) * part / parts)
        stuck = np.linalg.solve(K, -wanted[..., None])[..., 0]
        sticks = np.linalg.norm(stuck[:, :2], axis=1) <= mu * stuck[:, 2]
        angle = np.arctan2(v[:, 1], v[:, 0])
        for _ in range(TURNS):
            push = np.stack([-mu * np.cos(angle), -mu * np.sin(angle), np.ones(len(v))], axis=1)
            pushed = np.einsum("nij,nj->ni", K, push)
            load = -wanted[:, 2] / pushed[:, 2]
            slip = v + pushed * load[:, None]
            turn = np.arctan2(slip[:, 1], slip[:, 0]) - angle
            turn = np.arctan2(np.sin(turn), np.cos(turn))
            angle = angle + 0.5 * turn
            if np.abs(turn).max() < CLOSE:
                break
        impulse = np.where(sticks[:, None], stuck, push * load[:, None])
        out, v = out + impulse, v + np.einsum("nij,nj->ni", K, impulse)
    return out


def misfits(hit: Impacts, model: ObjectModel, values: Array, parts: int) -> Array:
    """(n, 6) predicted less measured jumps of velocity and spin, over `SPEED` and `SPIN`.

    Args:
        hit: Impacts.
        model: The stated object, whose inertia and mass are known.
        values: (5,) inertia over the stated about each axis, restitution, friction.
        parts: As of `impulses`.
    """
    mass, turned, arm = float(model.mass[0]), quat_to_matrix(hit.q), skew(hit.arm)
    yields = turned @ np.linalg.inv(model.inertia[0] * np.sqrt(np.outer(values[:3], values[:3]))) @ turned.mT
    K = np.eye(3) / mass - arm @ yields @ arm
    J = impulses(K, hit.before, mu=float(values[4]), restitution=float(values[3]), parts=parts)
    spin = np.einsum("nij,nj->ni", yields, np.cross(hit.arm, J))
    return np.concatenate([(J / mass - hit.dv) / SPEED, (spin - hit.dw) / SPIN], axis=1)


def fitted(hit: Impacts, model: ObjectModel, parts: int) -> tuple[Array, Array]:
    """The five values of `misfits` that fit best, and (n, 6) what they leave.

    Args:
        hit: Impacts.
        model: The stated object.
        parts: As of `impulses`.
    """
    found = least_squares(
        lambda x: limited(misfits(hit, model, x, parts)).ravel(), [1.2, 1.2, 1.2, 0.2, model.friction],
        bounds=([0.2, 0.2, 0.2, 0.0, 0.0], [5.0, 5.0, 5.0, 1.0, 2.0]), diff_step=1e-4,
    )  # fmt: skip
    return found.x, misfits(hit, model, found.x, parts)


def limited(misfit: Array) -> Array:
    """Misfits of which none counts much more than five.

    Args:
        misfit: In the argument's shape.
    """
    return 5 * np.arctan(misfit / 5)


def table(hit: Impacts, model: ObjectModel) -> str:
    """What each law leaves, in Markdown.

    Args:
        hit: Impacts.
        model: The stated object.

    Raises:
        InputError: Too few impacts.
    """
    if len(hit.toss) < FEWEST:
        raise InputError(f"{len(hit.toss)} impacts on a lone corner between two flights, expected at least {FEWEST}")
    rows = [
        "| friction against the slip | inertia | restitution | friction | left [mm/s] | left [rad/s] | cost |",
        "|---" * 7 + "|",
    ]
    costs = {}
    for name, parts in LAWS.items():
        values, left = fitted(hit, model, parts)
        cost = 0.5 * (limited(left) ** 2).sum(axis=1)
        costs[name] = np.bincount(hit.toss, weights=cost)[np.unique(hit.toss)]
        size = np.median(np.abs(left), axis=0)
        rows.append(
            f"| {name} | {', '.join(f'{x:.3f}' for x in values[:3])} | {values[3]:.3f} | {values[4]:.3f} "
            f"| {', '.join(f'{1e3 * SPEED * x:.0f}' for x in size[:3])} "
            f"| {', '.join(f'{SPIN * x:.2f}' for x in size[3:])} | {cost.sum():.0f} |"
        )
    first, second = costs.values()
    p = float(wilcoxon(first - second, alternative="greater").pvalue)
    rows.append(
        f"\n{len(hit.toss)} impacts. Routh's law leaves less in {(second < first).sum()} of {len(first)} tosses"
    )
    return "\n".join(rows) + f" (p = {p:.1g})."


def main() -> None:
    """Print the table."""
    dataset, tosses, world = asked(arguments(__doc__).parse_args())
    print(table(lone_impacts(tosses, world), dataset.object))  # noqa: T201


if __name__ == "__main__":
    main()
