"""What explains tosses gains most in closed form, and chance is as rare as stated."""

from __future__ import annotations

import numpy as np

from tests.diagnosis.by_hand import EFFECTS
from tossid.diagnosis.inference.hypothesis import ContactLaw, Hypothesis
from tossid.diagnosis.inference.sample import Sample
from tossid.diagnosis.inference.screening import Score, adjusted_p_values, screen
from tossid.physics.effects import effects_for


def test_the_effect_that_is_there_gains_most_and_is_significant(slippery: Sample, stated: Hypothesis) -> None:
    library = effects_for(stated.base.object)
    found = screen(slippery.evidence(stated), library, n=slippery.n, rng=np.random.default_rng(0))
    first = found.candidates[0]
    # what contains friction may gain as much
    assert "friction" in (first.name, *EFFECTS[first.name].contains)
    friction = next(c for c in found.candidates if c.name == "friction")
    assert friction.p_value < 0.025
    assert friction.total > 50
    assert [effect.name for effect, _ in found.together(1, 3.0)] == [first.name]
    gravity = next(c for c in found.candidates if c.name == "gravity")
    assert gravity.total < 3


def test_another_law_of_contact_is_a_candidate(slippery: Sample, stated: Hypothesis) -> None:
    laws = (ContactLaw(), ContactLaw("relaxed", lifting=1e-4))
    found = screen(slippery.evidence(stated), (), n=slippery.n, laws=laws, rng=np.random.default_rng(0))
    assert [c.name for c in found.candidates] == ["relaxed"]
    assert found.candidates[0].start.law.name == "relaxed"


def test_effects_are_chosen_together_beside_those_that_are_there(slippery: Sample, stated: Hypothesis) -> None:
    """Also where a special case of one makes room for it."""
    made = slippery.evaluated(slippery.evidence(stated.plus(EFFECTS["gravity"], np.array([9.7]))))
    h = made.hypothesis.plus(EFFECTS["friction"])
    near = made.evidence.relinearised(h)
    others = [EFFECTS[name] for name in ("gravity", "anisotropic_friction", "restitution")]
    found = screen(near, others, n=slippery.n, free=(1,), rng=np.random.default_rng(0))
    chosen = found.together(3, -1e9)
    assert {effect.name for effect, _ in chosen} == {"anisotropic_friction", "restitution"}
    general = next(c for c in found.candidates if c.name == "anisotropic_friction")
    assert general.start.names == ("gravity", "anisotropic_friction")
    assert general.start.values_of("gravity").tolist() == [9.7]


def test_what_could_take_an_effects_place_is_found_in_closed_form(slippery: Sample, stated: Hypothesis) -> None:
    h = stated.plus(EFFECTS["friction"])
    made = slippery.refitted(slippery.evidence(stated), h, iterations=6, follow=1)
    others = [EFFECTS[name] for name in ("gravity", "anisotropic_friction")]
    found = screen(made.evidence, others, n=slippery.n, free=made.free, rng=np.random.default_rng(0))
    shares = {
        c.name: share for share, c in found.replacements(made.columns_of("friction"), made.from_nominal("friction"))
    }
    assert shares["anisotropic_friction"] > 0.8
    assert shares["gravity"] < 0.1


def test_chance_is_as_rare_as_stated_however_alike_and_uneven_tosses_are() -> None:
    rng, small = np.random.default_rng(4), 0
    for _ in range(150):
        size = rng.lognormal(0, 1.0, size=(12, 1))
        common = rng.standard_t(4, size=(12, 1)) * size
        scores = [common + rng.standard_t(4, size=(12, 1 + k % 3)) * size for k in range(8)]
        group = [[Score(u, u.T @ u, False)] for u in scores]
        small += min(adjusted_p_values(group, rng, flips=999)) < 0.05
    assert small / 150 < 0.105  # 0.05, and three standard errors


def test_a_start_counts_forward_only() -> None:
    u = np.full((12, 1), 2.0)
    away, towards = (
        adjusted_p_values([[Score(sign * u, u.T @ u, True)]], np.random.default_rng(0)) for sign in (1, -1)
    )
    assert away == [1.0]
    assert towards[0] < 0.01
