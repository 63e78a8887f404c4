"""Which importer reads an ONNX file's metadata: BeyondMimic and mjlab, holosoma, or exploy."""

from __future__ import annotations

from unicon_core.errors import PolicyError
from unicon_core.policies.facts import Facts
from unicon_core.policies.importers.exploy import exploy_facts
from unicon_core.policies.importers.holosoma import holosoma_facts
from unicon_core.policies.importers.mjlab import mjlab_facts
from unicon_core.policies.networks.onnx_file import OnnxFile

__all__ = ["has_metadata", "metadata_facts"]


def _kind(onnx: OnnxFile) -> str | None:
    keys = {key for key, _ in onnx.metadata}
    if "exploy_version" in keys:
        return "exploy"
    if "dof_names" in keys:
        return "holosoma"
    return "mjlab" if "joint_names" in keys else None


def has_metadata(onnx: OnnxFile) -> bool:
    """Whether the metadata are of a known format."""
    return _kind(onnx) is not None


def metadata_facts(onnx: OnnxFile) -> Facts:
    """Return what the metadata say.

    Raises:
        PolicyError: no known format, a key twice, or a value against the format.
    """
    kind = _kind(onnx)
    if kind == "exploy":
        return exploy_facts(onnx)
    if kind == "holosoma":
        return holosoma_facts(onnx)
    if kind == "mjlab":
        return mjlab_facts(onnx)
    raise PolicyError(
        f"{onnx.path}: its metadata are of no known format (BeyondMimic, mjlab, holosoma, exploy); "
        "write a policy.yaml beside it"
    )
