"""Layouts of Image and PointCloud2, held against rosbags' codec."""

from __future__ import annotations

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from unicon_base.errors import UniconError
from unicon_core.models.camera import Intrinsics
from unicon_ros.bridge.images import (
    INFO,
    KINDS,
    STAMP,
    frame_message,
    info_message,
    jpeg_message,
    rays,
)

STORE = get_typestore(Stores.ROS2_JAZZY)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("width", "height"), [(1, 1), (3, 2), (5, 7)])
@pytest.mark.parametrize("frame_id", ["", "a", "camera_optical_frame"])
def test_rosbags_reads_what_was_laid_out(kind: str, width: int, height: int, frame_id: str) -> None:
    layout = frame_message(kind, width, height, frame_id)
    buffer = bytearray(layout.template)
    into = layout.data(buffer)
    into[...] = np.arange(into.size).reshape(into.shape) % 200
    layout.stamp(buffer, 1_700_000_000_123_456_789)
    message = STORE.deserialize_cdr(bytes(buffer), layout.type)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1_700_000_000, 123_456_789)
    assert message.header.frame_id == frame_id
    assert (message.width, message.height) == (width, height)
    assert message.data.tobytes() == into.tobytes()
    # The same bytes again: nothing stands between the fields that should not.
    assert bytes(STORE.serialize_cdr(message, layout.type)) == bytes(buffer)
    if kind == "cloud":
        found = [(f.name, f.offset, f.datatype, f.count) for f in message.fields]
        assert found == [("x", 0, 7, 1), ("y", 4, 7, 1), ("z", 8, 7, 1)]
        assert (message.point_step, message.row_step) == (12, 12 * width)
        assert not message.is_dense
    else:
        assert message.encoding == {"color": "rgb8", "depth": "32FC1"}[kind]
        assert message.step == {"color": 3, "depth": 4}[kind] * width


@pytest.mark.parametrize("frame_id", ["", "a", "camera_optical_frame"])
@pytest.mark.parametrize("count", [2, 7, 9])
def test_rosbags_reads_a_jpeg_of_any_length(frame_id: str, count: int) -> None:
    layout = jpeg_message(9, frame_id)
    buffer = bytearray(layout.template)
    for data in (b"\xff\xd8longer.", bytes(range(count))):  # what was there before is cut off
        length = layout.put(buffer, memoryview(data))
    layout.stamp(buffer, 1_700_000_000_123_456_789)
    message = STORE.deserialize_cdr(bytes(buffer[:length]), layout.type)
    assert (message.header.frame_id, message.format) == (frame_id, "jpeg")
    assert message.header.stamp.nanosec == 123_456_789
    assert message.data.tobytes() == bytes(range(count))
    assert bytes(STORE.serialize_cdr(message, layout.type)) == bytes(buffer[:length])


def test_camera_info_tells_distortion() -> None:
    coefficients = (0.1, -0.2, 0.001, 0.002, 0.05)
    raw = info_message(8, 6, "a", Intrinsics(5.0, 6.0, 3.5, 2.5), coefficients)
    message = STORE.deserialize_cdr(raw, INFO)
    assert (message.distortion_model, *message.d) == ("plumb_bob", *coefficients)


def test_rays_open_as_wide_as_the_field_of_view() -> None:
    height, width, fovy = 240, 320, np.radians(60.0)
    focal = 0.5 * height / np.tan(0.5 * fovy)
    found = rays(width, height, Intrinsics(focal, focal, 0.5 * (width - 1), 0.5 * (height - 1)))
    assert found.shape == (height, width, 3)
    np.testing.assert_allclose(found[..., 2], 1.0)
    # The image's upper edge is half a pixel above the uppermost ray.
    edge = -found[0, 0, 1] + 0.5 * (found[1, 0, 1] - found[0, 0, 1])
    assert edge == pytest.approx(np.tan(fovy / 2))
    assert found[0, 0, 0] < 0 < found[0, -1, 0]  # x right
    assert found[0, 0, 1] < 0 < found[-1, 0, 1]  # y down


@pytest.mark.parametrize("frame_id", ["", "a", "camera_optical_frame"])
def test_rosbags_reads_the_camera_info_of_a_pinhole(frame_id: str) -> None:
    raw = bytearray(info_message(320, 240, frame_id, Intrinsics(200.0, 201.0, 159.5, 119.5)))
    image = bytearray(frame_message("color", 320, 240, frame_id).template)
    frame_message("color", 320, 240, frame_id).stamp(image, 1_700_000_000_123_456_789)
    raw[STAMP] = image[STAMP]
    info = STORE.deserialize_cdr(bytes(raw), INFO)
    assert bytes(STORE.serialize_cdr(info, INFO)) == bytes(raw)
    assert (info.header.stamp.sec, info.header.stamp.nanosec) == (1_700_000_000, 123_456_789)
    assert (info.header.frame_id, info.width, info.height) == (frame_id, 320, 240)
    assert (info.distortion_model, info.d.tolist()) == ("plumb_bob", [0.0] * 5)
    k = np.array([[200.0, 0.0, 159.5], [0.0, 201.0, 119.5], [0.0, 0.0, 1.0]])
    assert info.k.reshape(3, 3).tolist() == k.tolist()
    assert info.r.reshape(3, 3).tolist() == np.eye(3).tolist()
    assert info.p.reshape(3, 4).tolist() == np.c_[k, np.zeros(3)].tolist()
    assert (info.binning_x, info.binning_y) == (0, 0)
    roi = info.roi
    region = (roi.x_offset, roi.y_offset, roi.height, roi.width, roi.do_rectify)
    assert region == (0, 0, 0, 0, False)


def test_a_camera_that_is_no_pinhole_is_told_as_not_calibrated() -> None:
    info = STORE.deserialize_cdr(info_message(4, 2, "a", Intrinsics(0.0, 0.0, 0.0, 0.0)), INFO)
    assert not info.k.any()
    assert not info.p.any()


def test_an_unknown_kind_lists_the_known_ones() -> None:
    with pytest.raises(UniconError, match=r"camera kind 'colour'.*color"):
        frame_message("colour", 2, 2, "")
