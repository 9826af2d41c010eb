"""The semantic image: hand-worked pictures, and what holds for every picture."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from haim_torchrl.envs.semantic import (
    CHANNELS,
    RoadLayers,
    SemanticConfig,
    SemanticRaster,
    band,
)

ROAD, LANE, VEHICLES, OBSTACLES, ROUTE = range(5)
NONE = np.zeros((0, 5))
METRE = SemanticConfig(size=60, reach=40.0, behind=20.0)
"""One metre is one pixel; the AV is in the corner of pixels 39 and 40, 29 and 30."""


def rectangle(left: float, right: float, bottom: float, top: float) -> np.ndarray:
    return np.array([[left, bottom], [right, bottom], [right, top], [left, top]])


def test_channels_and_shape():
    assert CHANNELS == ("road", "lane", "vehicles", "obstacles", "route")
    image = SemanticRaster(SemanticConfig(), RoadLayers()).draw((0, 0, 0), NONE, NONE)
    assert image.shape == SemanticConfig().shape == (5, 84, 84)
    assert image.dtype == np.uint8
    assert not image.any()


def test_a_box_straight_ahead_fills_the_pixels_of_its_area():
    raster = SemanticRaster(METRE, RoadLayers())
    image = raster.draw((0, 0, 0), np.array([[10.0, 0.0, 0.0, 4.0, 2.0]]), NONE)
    expected = np.zeros((60, 60))
    expected[28:32, 29:31] = 255  # 8 to 12 m ahead, 1 m to either side
    np.testing.assert_array_equal(image[VEHICLES], expected)
    assert not image[[ROAD, LANE, OBSTACLES, ROUTE]].any()


def test_half_a_pixel_is_grey():
    raster = SemanticRaster(METRE, RoadLayers())
    image = raster.draw((0.5, 0, 0), NONE, np.array([[10.0, 0.0, 0.0, 4.0, 2.0]]))
    np.testing.assert_array_equal(image[OBSTACLES, 28:33, 29], [128, 255, 255, 255, 128])


def test_left_is_left_and_behind_is_behind():
    raster = SemanticRaster(METRE, RoadLayers())
    image = raster.draw((0, 0, 0), np.array([[-10.0, 12.0, 0.0, 2.0, 2.0]]), NONE)
    rows, columns = np.nonzero(image[VEHICLES])
    assert set(rows) == {49, 50}
    assert set(columns) == {17, 18}


def test_heading_is_up():
    """The AV looks along +y: what is at +y is ahead, what is at +x is on its right."""
    raster = SemanticRaster(METRE, RoadLayers())
    boxes = np.array([[0.0, 10.0, 0.0, 2.0, 4.0], [10.0, 0.0, 0.0, 2.0, 2.0]])
    image = raster.draw((0, 0, np.pi / 2), boxes, NONE)[VEHICLES]
    assert (image[28:32, 29:31] == 255).all()
    assert (image[39:41, 39:41] == 255).all()
    assert np.count_nonzero(image > 2) == 8 + 4


def test_a_small_thing_does_not_fade():
    raster = SemanticRaster(METRE, RoadLayers())
    image = raster.draw((0, 0, 0), NONE, np.array([[10.5, 0.5, 0.0, 0.1, 0.1]]))
    assert image[OBSTACLES, 29, 29] == 255
    assert np.count_nonzero(image) == 1


def test_boxes_out_of_sight_are_not_drawn():
    raster = SemanticRaster(METRE, RoadLayers())
    far = [[x, y, 0.3, 4.5, 2.0] for x, y in ((60, 0), (-40, 0), (0, 50), (0, -50))]
    assert not raster.draw((0, 0, 0), np.array(far), np.array(far)).any()


def test_layers_of_the_road():
    """A road 8 m wide along +x with its middle marked; its left half is the route."""
    layers = RoadLayers(
        surfaces=[rectangle(-100, 100, -4, 4)],
        lines=[np.array([[-100.0, 0.0], [100.0, 0.0]])],
        route=[rectangle(-100, 100, 0, 4)],
    )
    image = SemanticRaster(METRE, layers).draw((0, 0, 0), NONE, NONE)
    # The map's own pixels are a quarter of a metre wide: an edge may be off by one of them.
    for channel, expected in (
        (ROAD, [0, 0, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0]),
        (LANE, [0, 0, 0, 0, 0, 0.5, 0.5, 0, 0, 0, 0, 0]),
        (ROUTE, [0, 0, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0]),
    ):
        np.testing.assert_allclose(image[channel, 30, 24:36] / 255, expected, atol=0.26)
    assert np.ptp(image[:, 5:55].astype(int), axis=1).max() == 0  # the same in each row


def test_turning_the_world_and_the_vehicle_changes_nothing():
    rng = np.random.default_rng(0)
    points = np.stack([np.arange(-60.0, 60.0), 8 * np.sin(np.arange(-60.0, 60.0) / 15)], 1)
    boxes = np.column_stack(
        [rng.uniform(-25, 25, (6, 2)), rng.uniform(-3, 3, 6), np.tile([4.5, 2.0], (6, 1))]
    )

    def picture(turn: float, shift: np.ndarray) -> np.ndarray:
        c, s = np.cos(turn), np.sin(turn)
        matrix = np.array([[c, s], [-s, c]])  # for points in rows
        line = points @ matrix + shift
        layers = RoadLayers(band(line, 12.0), [line], band(line, 6.0))
        moved = boxes.copy()
        moved[:, :2] = boxes[:, :2] @ matrix + shift
        moved[:, 2] += turn
        raster = SemanticRaster(SemanticConfig(size=42), layers)
        return raster.draw((*shift, turn), moved, NONE).astype(float)

    here, there = picture(0.0, np.zeros(2)), picture(0.7, np.array([300.0, -120.0]))
    np.testing.assert_array_equal(here[VEHICLES], there[VEHICLES])
    # The map has cells of half a pixel, which lie differently: only edges may differ a little.
    for channel in (ROAD, LANE, ROUTE):
        assert np.abs(here[channel] - there[channel]).mean() < 3.0


@given(
    heading=st.floats(-3, 3),
    forward=st.floats(-15, 35),
    left=st.floats(-25, 25),
    turn=st.floats(-3, 3),
)
def test_the_mirrored_scene_is_the_mirrored_image(heading, forward, left, turn):
    raster = SemanticRaster(SemanticConfig(size=42), RoadLayers())

    def image(side: float) -> np.ndarray:
        c, s = np.cos(heading), np.sin(heading)
        x, y = c * forward - s * side * left, s * forward + c * side * left
        box = np.array([[x, y, heading + side * turn, 4.5, 2.0]])
        return raster.draw((0, 0, heading), box, NONE)[VEHICLES].astype(int)

    np.testing.assert_allclose(image(1.0), image(-1.0)[:, ::-1], atol=1)
    area = image(1.0).sum() / 255 * SemanticConfig(size=42).pixel ** 2
    assert 7.0 < area < 13.0  # 9 m^2: shares of pixels are nearly right at every angle


def test_a_band_goes_round_a_loop_without_holes():
    angle = np.linspace(0, 4 * np.pi, 200)  # twice round
    circle = np.stack([10 * np.cos(angle), 10 * np.sin(angle)], 1)
    raster = SemanticRaster(METRE, RoadLayers(surfaces=band(circle, 4.0)))
    image = raster.draw((0, 0, 0), NONE, NONE)[ROAD]
    assert image[30, 30] == 255 == image[39, 40]  # ahead of and beside the centre
    assert image[39, 30] == 0
    area = image.sum() / 255
    # pygame fills up to and including the border, here an eighth of a metre on either side.
    assert area == pytest.approx(np.pi * (12.125**2 - 7.875**2), rel=0.02)


@pytest.mark.parametrize("name, value", [("size", 4), ("reach", 0.0), ("behind", -1.0)])
def test_settings_that_make_no_image_are_refused(name, value):
    with pytest.raises(ValueError, match=f"^{name}: "):
        SemanticConfig(**{name: value})


def test_points_of_the_wrong_shape_are_refused():
    with pytest.raises(ValueError, match=r"^lines: points must be \[P, 2\]"):
        SemanticRaster(METRE, RoadLayers(lines=[np.zeros((3, 3))]))
