import numpy as np
import pytest

from tossid.motion.momentum.balance import Balance
from tossid.settings.motion import MomentumSettings
from tossid.types import Phase

pytestmark = pytest.mark.slow

SETTINGS = MomentumSettings()


@pytest.fixture(scope="module")
def balance(wedge):
    found = Balance(wedge.tosses, wedge.true, 9.81, SETTINGS)
    found.linearise(wedge.true.inertia)
    return found


def test_true_body_leaves_white_noise_in_flight(balance, wedge):
    r = balance.residuals(wedge.true.inertia)
    flying = ~balance.touching.any(axis=-1)
    first = np.cumprod(flying, axis=0).astype(bool)  # until the first contact; the first two frames start the filter
    size = (r[2:] ** 2).mean(axis=-1)[first[1:]]
    assert len(size) > 200
    assert size.mean() == pytest.approx(1.0, abs=0.1)


def test_wrong_inertia_and_friction_show(balance, wedge):
    I, mu = wedge.true.inertia, wedge.true.friction
    misfit = lambda inertia, friction=None: (balance.residuals(inertia, friction) ** 2).sum()  # noqa: E731
    assert misfit(0.85 * I) > misfit(I) + 20
    assert misfit(1.15 * I) > misfit(I) + 20
    assert misfit(I, mu - 0.05) > misfit(I, mu) + 20
    assert misfit(I, mu + 0.05) > misfit(I, mu) + 20


def test_nothing_touches_in_flight_and_sliding_is_contact(balance, wedge):
    assert not (balance.sliding & ~balance.touching).any()
    assert balance.sliding.any()
    for i, toss in enumerate(wedge.tosses):
        n = int(np.argmax(toss.phase != Phase.FLIGHT)) - 2
        assert not balance.touching[: max(n, 0), i].any()
