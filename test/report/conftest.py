"""Tests of pages need matplotlib."""

import pytest

pytest.importorskip("matplotlib")
