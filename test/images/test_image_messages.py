"""Layouts of Image and PointCloud2, held against rosbags' codec."""

from __future__ import annotations

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from unicon_core.errors import UniconError
from unicon_ros.bridge.images import KINDS, frame_message, rays

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


def test_rays_open_as_wide_as_the_field_of_view() -> None:
    height, width, fovy = 240, 320, np.radians(60.0)
    found = rays(width, height, fovy)
    assert found.shape == (height, width, 3)
    np.testing.assert_allclose(found[..., 2], 1.0)
    # The image's upper edge is half a pixel above the uppermost ray.
    edge = -found[0, 0, 1] + 0.5 * (found[1, 0, 1] - found[0, 0, 1])
    assert edge == pytest.approx(np.tan(fovy / 2))
    assert found[0, 0, 0] < 0 < found[0, -1, 0]  # x right
    assert found[0, 0, 1] < 0 < found[-1, 0, 1]  # y down


def test_an_unknown_kind_lists_the_known_ones() -> None:
    with pytest.raises(UniconError, match=r"camera kind 'colour'.*color"):
        frame_message("colour", 2, 2, "")
