"""What the parts of the conformance suite share: the platform under test and its rigs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar

import pytest

from unicon_core.conformance.rig import Rig

# Before they are imported: else pytest says of an assertion of theirs only that it failed.
pytest.register_assert_rewrite(*(f"{__package__}.{part}" for part in ("contract", "mechanics")))

Build = Callable[..., Rig]
"""As `Rig`, without platform and folder; `options` are over those of the case."""


class Case:
    """A platform under test; a subclass names it."""

    platform: ClassVar[str]
    options: ClassVar[Mapping[str, Any]] = {}
    near: ClassVar[float] = 1e-4
    """Relative difference that is taken for rounding: of engines in float32 more."""

    @pytest.fixture
    def rig(self, tmp_path: Path) -> Iterator[Build]:
        """Build robots on the platform; all are closed in the end."""
        built: list[Rig] = []

        def build(**how: Any) -> Rig:
            folder = tmp_path / f"rig{len(built)}"
            folder.mkdir()
            options = {**self.options, **how.pop("options", {})}
            one = Rig(self.platform, folder, options, **how)
            built.append(one)
            return one

        yield build
        for one in built:
            one.close()
