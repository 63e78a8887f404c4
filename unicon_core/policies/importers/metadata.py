"""Which importer reads an ONNX file's metadata: BeyondMimic and mjlab, holosoma, or exploy."""

from __future__ import annotations

from collections.abc import Callable

from unicon_core.errors import PolicyError
from unicon_core.policies.facts import Facts
from unicon_core.policies.importers.exploy import exploy_facts
from unicon_core.policies.importers.holosoma import holosoma_facts
from unicon_core.policies.importers.mjlab import mjlab_facts
from unicon_core.policies.networks.onnx_file import OnnxFile

__all__ = ["has_metadata", "metadata_facts"]


# A key that tells the format -> its reader; the first one counts.
_READERS: dict[str, Callable[[OnnxFile], Facts]] = {
    "exploy_version": exploy_facts,
    "dof_names": holosoma_facts,
    "joint_names": mjlab_facts,
}


def _reader(onnx: OnnxFile) -> Callable[[OnnxFile], Facts] | None:
    keys = {key for key, _ in onnx.metadata}
    return next((reader for key, reader in _READERS.items() if key in keys), None)


def has_metadata(onnx: OnnxFile) -> bool:
    """Whether the metadata are of a known format."""
    return _reader(onnx) is not None


def metadata_facts(onnx: OnnxFile) -> Facts:
    """Return what the metadata say.

    Raises:
        PolicyError: no known format, a key twice, or a value against the format.
    """
    reader = _reader(onnx)
    if reader is None:
        raise PolicyError(
            f"{onnx.path}: its metadata are of no known format (BeyondMimic, mjlab, holosoma, "
            "exploy); write a policy.yaml beside it"
        )
    return reader(onnx)
