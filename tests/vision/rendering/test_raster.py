"""The renderer's optics: defocus, focus, glare, and which share of a tag is visible."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.objects import ObjectModel
from tossid.rotations import quat_exp
from tossid.settings.rendering import RenderSettings
from tossid.types import Frame
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import default_rig, look_at
from tossid.vision.cameras.shutter import Shutter
from tossid.vision.detection.detect import TagFinder
from tossid.vision.rendering.render import Renderer
from tossid.vision.setup.faces import default_tags

DT = 1 / 148


def _facing(width: int = 300, height: int = 240) -> Camera:
    """A camera that looks along -x at the height 0.5 m, one metre from the origin's axis."""
    T = look_at([1.0, 1e-9, 0.5], [0.0, 0.0, 0.5])
    return Camera("c", (width, height), [400, 400, (width - 1) / 2, (height - 1) / 2], T_rig_cam=T)


def test_defocus_widens_an_edge_as_a_thin_lens_does(cube: ObjectModel):
    """The line spread of a disc of diameter c is half an ellipse, whose standard deviation is c/4."""
    camera, focus = _facing(), 0.6
    q = np.array([0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0])
    for aperture in (0.0, 0.01, 0.02):
        settings = RenderSettings(blur=0.0, noise=0.0, ambient=1.0, samples=256, aperture=aperture, focus=focus)
        renderer = Renderer(cube, [camera], settings)
        level = renderer.render(q, q, "c", None)[100:140, 150:].astype(float).mean(axis=0)
        spread = -np.diff(level[:60])
        columns = np.arange(len(spread))
        keep = np.abs(columns - np.argmax(spread)) < 12
        spread, columns = np.clip(spread[keep], 0, None), columns[keep]
        middle = np.average(columns, weights=spread)
        variance = np.average((columns - middle) ** 2, weights=spread)
        disc = aperture * 400 * abs(1 / (1 - 0.0524) - 1 / focus)
        # a pixel's own width, once by its area and once by the difference
        assert variance == pytest.approx(disc**2 / 16 + 2 / 12, abs=0.05 + 0.04 * disc**2 / 16)
    assert disc > 4


def test_the_plane_in_focus_stays_sharp(tagged: ObjectModel):
    camera = _facing()
    q = np.array([0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0])
    sharp, focused = (
        Renderer(tagged, [camera], RenderSettings(noise=0.0, aperture=a, focus=1 - 0.0524)).render(q, q, "c", None)
        for a in (0.0, 0.03)
    )
    face = (slice(100, 140), slice(130, 170))
    assert np.abs(sharp[face].astype(int) - focused[face]).max() <= 2


def test_glare_lies_where_a_mirror_would_show_the_lamp(tagged: ObjectModel):
    camera = default_rig(n_cameras=1)[0]
    settings = RenderSettings(noise=0.0, blur=0.0, glare=1.0, gloss=3000.0, samples=32)
    lamp = settings.lamp * np.array(settings.light) / np.linalg.norm(settings.light)
    eye = camera.T_world_cam[:3, 3]
    at = np.array([0.0, 0.0, 0.2])
    for _ in range(20):  # the face whose mirror image of the lamp is in its middle
        normal = (lamp - at) / np.linalg.norm(lamp - at) + (eye - at) / np.linalg.norm(eye - at)
        normal /= np.linalg.norm(normal)
        at = np.array([0.02, 0.01, 0.2])
    turn = np.cross([0.0, 0.0, 1.0], normal)
    quat = quat_exp(turn / np.linalg.norm(turn) * np.arcsin(np.linalg.norm(turn)))
    q = np.array([*(at - 0.0524 * normal), *quat])
    plain = Renderer(tagged, [camera], RenderSettings(noise=0.0, blur=0.0, samples=32)).render(q, q, "cam0", None)
    shiny = Renderer(tagged, [camera], settings).render(q, q, "cam0", None)
    added = shiny.astype(float) - plain
    dark = plain < 60  # where nothing saturates
    rows, columns = np.nonzero(dark & (added > 0.5 * added[dark].max()))
    middle = np.average(np.column_stack([columns, rows]), axis=0, weights=added[rows, columns])
    np.testing.assert_allclose(middle, camera.project(at[None])[0], atol=6.0)
    assert added[dark].max() > 100
    found = {d.tag_id for d in TagFinder(camera, tagged).find(Frame("cam0", 0.0, shiny))}
    before = {d.tag_id for d in TagFinder(camera, tagged).find(Frame("cam0", 0.0, plain))}
    assert found <= before


def test_visible_shares_are_those_of_the_picture(elbow: ObjectModel):
    """Seen along y with the hinge at zero, the second link's near face is hidden and the first one's is not."""
    model = elbow.with_changes(tags=default_tags(elbow))
    camera = Camera("c", (640, 512), [900, 900, 320, 256], T_rig_cam=look_at([0.0, -0.8, 0.3001], [0.0, 0.0, 0.3]))
    renderer = Renderer(model, [camera])
    q = np.array([0.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0, 0.0])
    exposure = Shutter().expose(np.array([0.0, DT]), np.stack([q, q]), 0, 512, 16)
    shares = dict(zip([tag.id for tag in model.tags], renderer.visible(exposure, "c"), strict=True))
    assert shares[3] == 1.0
    assert shares[9] == 0.0
    assert all(0 <= share <= 1 for share in shares.values())
    aside = q + np.array([camera.T_world_cam[0, 3] + 0.8 * 320 / 900, 0, 0, 0, 0, 0, 0, 0])  # on the image's edge
    exposure = Shutter().expose(np.array([0.0, DT]), np.stack([aside, aside]), 0, 512, 16)
    assert 0.2 < renderer.visible(exposure, "c")[3] < 0.8
