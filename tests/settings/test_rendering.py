"""Values that no image can have are refused."""

from __future__ import annotations

import pytest

from tossid.errors import InputError
from tossid.settings.rendering import RenderSettings


@pytest.mark.parametrize("wrong", [{"samples": 0}, {"noise": -1.0}, {"ambient": 1.1}, {"glare": -0.1}, {"focus": -1.0}])
def test_what_no_image_can_have_is_refused(wrong: dict[str, float]) -> None:
    (name,) = wrong
    with pytest.raises(InputError, match=name):
        RenderSettings(**wrong)


def test_the_lens_is_a_radius_and_a_distance() -> None:
    assert RenderSettings(aperture=0.01, focus=2.0).lens == (0.005, 2.0)
