"""Where a network runs is said by a word; what is absent is refused, and nothing falls back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from policy_helpers import toy_values, write_toy

from unicon_base.errors import MissingDependencyError, PolicyError
from unicon_core.policies import import_policy, load_policy
from unicon_core.policies.networks import open_network

onnxruntime: Any = pytest.importorskip("onnxruntime", reason="providers are those of onnxruntime")

ABSENT = [
    word
    for word, name in (("cuda", "CUDA"), ("tensorrt", "Tensorrt"))
    if f"{name}ExecutionProvider" not in onnxruntime.get_available_providers()
]


@pytest.mark.parametrize("word", ABSENT)
def test_a_provider_that_is_absent_is_refused_with_what_there_is(tmp_path: Path, word: str) -> None:
    contract = load_policy(write_toy(tmp_path, toy_values(provider=word)))
    with pytest.raises(MissingDependencyError, match=r"available: cpu.*pip install onnxruntime-"):
        open_network(contract)


def test_a_provider_that_does_not_start_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # As with onnxruntime-gpu on a machine without a driver: listed, then quietly left out.
    contract = load_policy(write_toy(tmp_path, toy_values(provider="cuda")))
    listed = ["CUDAExecutionProvider", "CPUExecutionProvider"]
    whole = onnxruntime.InferenceSession

    def without_driver(path: str, sess_options: Any, providers: list[str]) -> Any:
        assert providers == ["CUDAExecutionProvider"]
        return whole(path, providers=["CPUExecutionProvider"])

    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: listed)
    monkeypatch.setattr(onnxruntime, "InferenceSession", without_driver)
    with pytest.raises(PolicyError, match=r"provider cuda does not start.*provider: cpu"):
        open_network(contract)


def test_the_workflow_wins_over_the_contract(tmp_path: Path) -> None:
    path = write_toy(tmp_path, toy_values(provider="cuda"))
    assert load_policy(path).provider == "cuda"
    contract = load_policy(path, given={"provider": "cpu"})
    assert contract.provider == "cpu"
    open_network(contract)


def test_an_import_keeps_the_provider(tmp_path: Path) -> None:
    path = write_toy(tmp_path / "from", toy_values(provider="tensorrt"))
    import_policy(path, tmp_path / "to")
    assert load_policy(tmp_path / "to").provider == "tensorrt"


@pytest.mark.parametrize("word", ["gpu", "CUDA", 3, ["cpu"]])
def test_other_words_are_refused(tmp_path: Path, word: Any) -> None:
    path = write_toy(tmp_path, toy_values(provider=word))
    with pytest.raises(
        PolicyError, match=r"provider .*(known: cpu, cuda,|write cpu or cuda or) tensorrt"
    ):
        load_policy(path)


def test_torchscript_runs_on_the_cpu(tmp_path: Path) -> None:
    values = toy_values(onnx=None, torchscript="policy.pt", provider="cuda")
    path = write_toy(tmp_path, values)
    with pytest.raises(PolicyError, match="TorchScript runs on the cpu"):
        load_policy(path)
