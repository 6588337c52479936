"""CLIP's two towers as torch modules for the export; they are plain transformers and load weights of both layouts."""

from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import torch
from safetensors.torch import load_file
from torch import nn

from zsdist.errors import WeightsError
from zsdist.vision.encoders.clip_layouts import Clip, Layout, TowerShape

Tower = TypeVar("Tower", bound=nn.Module)
Weights = Sequence[Path]
"""Files of a model's weights: one, or several shards."""

LARGEST_BYTES = 2_000_000_000
"""Greatest size of one tower's weights: a file of the export format holds no more."""

OPEN_CLIP_NAMES = (  # parts of weight names: open_clip's, and the Hugging Face's that are used here
    ("transformer.resblocks.", "encoder.layers."),
    (".ln_1.", ".layer_norm1."),
    (".ln_2.", ".layer_norm2."),
    (".attn.out_proj.", ".self_attn.out_proj."),
    (".mlp.c_fc.", ".mlp.fc1."),
    (".mlp.c_proj.", ".mlp.fc2."),
    ("conv1.", "embeddings.patch_embedding."),
    ("class_embedding", "embeddings.class_embedding"),
    ("token_embedding.", "embeddings.token_embedding."),
    ("positional_embedding", "embeddings.position_embedding.weight"),
    ("ln_pre.", "pre_layrnorm."),
    ("ln_post.", "post_layernorm."),
    ("ln_final.", "final_layer_norm."),
)


class Layer(nn.Module):
    """Transformer layer with normalisation first; `bias` `(L, L)` is added to the attention scores."""

    def __init__(self, shape: TowerShape) -> None:
        super().__init__()
        width = shape.width
        self.layer_norm1, self.layer_norm2 = (nn.LayerNorm(width, shape.epsilon) for _ in range(2))
        self.self_attn = nn.ModuleDict(
            {name: nn.Linear(width, width) for name in ("q_proj", "k_proj", "v_proj", "out_proj")}
        )
        self.mlp = nn.ModuleDict({"fc1": nn.Linear(width, shape.inner), "fc2": nn.Linear(shape.inner, width)})
        self._shape = shape

    def forward(self, x: torch.Tensor, bias: torch.Tensor | None = None) -> torch.Tensor:
        """Return the layer's output `(B, L, width)` for an input of the same shape."""
        shape, normed = self._shape, self.layer_norm1(x)
        split = (x.shape[0], x.shape[1], shape.heads, shape.width // shape.heads)
        query, key, value = (self.self_attn[f"{name}_proj"](normed).view(split).transpose(1, 2) for name in "qkv")
        scores = query @ key.transpose(2, 3) / split[-1] ** 0.5
        if bias is not None:
            scores = scores + bias
        attended = (scores.softmax(-1) @ value).transpose(1, 2).reshape(x.shape)
        x = x + self.self_attn["out_proj"](attended)
        inner = self.mlp["fc1"](self.layer_norm2(x))
        inner = inner * torch.sigmoid(1.702 * inner) if shape.activation == "quick_gelu" else nn.functional.gelu(inner)
        return x + self.mlp["fc2"](inner)


class ImageTower(nn.Module):
    """Tower from images `(B, px, px, 3)` uint8 to tokens `(B, side, side, width)` and unit embeddings `(B, D)`."""

    mean: torch.Tensor
    std: torch.Tensor

    def __init__(self, clip: Clip) -> None:
        super().__init__()
        shape, self._side = clip.vision, clip.image_px // clip.patch_px
        self.embeddings = nn.ParameterDict({"class_embedding": nn.Parameter(torch.empty(shape.width))})
        self.patches = nn.Conv2d(3, shape.width, clip.patch_px, clip.patch_px, bias=False)
        self.positions = nn.Embedding(self._side**2 + 1, shape.width)
        self.pre_layrnorm, self.post_layernorm = (nn.LayerNorm(shape.width, shape.epsilon) for _ in range(2))
        self.layers = nn.ModuleList(Layer(shape) for _ in range(shape.layers))
        self.projection = nn.Linear(shape.width, clip.dimensions, bias=False)
        self.register_buffer("mean", torch.tensor(clip.mean), persistent=False)
        self.register_buffer("std", torch.tensor(clip.std), persistent=False)

    def forward(self, images: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the patch tokens after the last normalisation, and the embedding of the class token."""
        x = self.patches(((images.float() / 255 - self.mean) / self.std).permute(0, 3, 1, 2))
        x = x.flatten(2).transpose(1, 2)
        first = self.embeddings["class_embedding"].expand(x.shape[0], 1, -1)
        x = self.pre_layrnorm(torch.cat([first, x], 1) + self.positions.weight)
        for layer in self.layers:
            x = layer(x)
        x = self.post_layernorm(x)
        tokens = x[:, 1:].unflatten(1, (self._side, self._side))
        return tokens, nn.functional.normalize(self.projection(x[:, 0]), dim=-1)


class TextTower(nn.Module):
    """Tower from token numbers `(N, L)` to embeddings `(N, D)` of unit length, taken at the end mark of the text."""

    later: torch.Tensor

    def __init__(self, clip: Clip, end: int) -> None:
        super().__init__()
        shape, self._end = clip.text, end
        self.words = nn.Embedding(clip.vocabulary, shape.width)
        self.positions = nn.Embedding(clip.context, shape.width)
        self.layers = nn.ModuleList(Layer(shape) for _ in range(shape.layers))
        self.final_layer_norm = nn.LayerNorm(shape.width, shape.epsilon)
        self.projection = nn.Linear(shape.width, clip.dimensions, bias=False)
        later = torch.full((clip.context, clip.context), -1e9).triu(1)
        self.register_buffer("later", later, persistent=False)  # masks the attention to later tokens

    def forward(self, ids: torch.Tensor) -> torch.Tensor:
        """Return embeddings `(N, D)`; tokens after a text's first end mark have no effect."""
        length = ids.shape[1]
        x = self.words(ids) + self.positions.weight[:length]
        for layer in self.layers:
            x = layer(x, self.later[:length, :length])
        x = self.final_layer_norm(x)
        last = ((ids == self._end).long().cumsum(1) == 0).long().sum(1)  # number of tokens before the first end mark
        x = x.gather(1, last[:, None, None].expand(-1, 1, x.shape[2]))[:, 0]
        return nn.functional.normalize(self.projection(x), dim=-1)


def image_tower(clip: Clip, weights: Weights) -> ImageTower:
    """Return the image tower with its weights; raise `WeightsError` if they are damaged or do not fit."""
    names = {
        "embeddings.patch_embedding.": "patches.",
        "embeddings.position_embedding.": "positions.",
        "encoder.layers.": "layers.",
    }
    return _filled(ImageTower(clip), clip, weights, ("vision_model.", "visual_projection."), names)


def text_tower(clip: Clip, weights: Weights, end: int) -> TextTower:
    """Return the text tower with its weights, for the tokenizer's end mark `end`; raises like `image_tower`."""
    names = {
        "embeddings.token_embedding.": "words.",
        "embeddings.position_embedding.": "positions.",
        "encoder.layers.": "layers.",
    }
    return _filled(TextTower(clip, end), clip, weights, ("text_model.", "text_projection."), names)


def projection(clip: Clip, weights: Weights) -> torch.Tensor:
    """Return the image tower's map `(D, width)` into text space; raise `WeightsError` if it is missing."""
    try:
        return _read(clip, weights)["visual_projection.weight"]
    except KeyError as error:
        raise WeightsError(f"encoder weights {weights[0]} lack {error}") from error


def _filled(tower: Tower, clip: Clip, weights: Weights, prefixes: tuple[str, str], names: dict[str, str]) -> Tower:
    own = {}
    model, mapped = prefixes
    for name, tensor in _read(clip, weights).items():
        if name.startswith(mapped):
            own[name.replace(mapped, "projection.")] = tensor
        elif name.startswith(model) and not name.endswith("position_ids"):
            name = name.removeprefix(model)
            for old, new in names.items():
                name = name.replace(old, new)
            own[name] = tensor
    if sum(tensor.numel() for tensor in own.values()) * 4 > LARGEST_BYTES:
        raise WeightsError(f"encoder weights {weights[0]} are too large; allowed are {LARGEST_BYTES} bytes a tower")
    try:
        tower.load_state_dict(own)
    except RuntimeError as error:
        raise WeightsError(
            f"encoder weights {weights[0]} do not fit their configuration: {' '.join(str(error).split())[:300]}"
        ) from error
    return tower


def _read(clip: Clip, weights: Weights) -> dict[str, torch.Tensor]:
    """Return all weights, float32, under Hugging Face's names."""
    loaded: dict[str, torch.Tensor] = {}
    for path in weights:
        try:
            loaded |= {name: tensor.float() for name, tensor in load_file(path).items()}
        except Exception as error:  # safetensors' errors share no narrower base class
            raise WeightsError(f"encoder weights {path} are damaged: {' '.join(str(error).split())[:200]}") from error
    return _renamed(loaded) if clip.layout is Layout.OPEN_CLIP else loaded


def _renamed(weights: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Return weights of open_clip under Hugging Face's names."""
    renamed = {}
    for name, tensor in weights.items():
        name = name.removeprefix("text.")  # prefix in open_clip's class with two separate towers
        tower = "vision_model." if name.startswith("visual.") else "text_model."
        part = name.removeprefix("visual.")
        if name == "visual.proj":
            renamed["visual_projection.weight"] = tensor.T
        elif part == "text_projection":
            renamed["text_projection.weight"] = tensor.T
        elif ".attn.in_proj_" in part:  # one matrix for queries, keys and values
            before, kind = part.replace("transformer.resblocks.", "encoder.layers.").split(".attn.in_proj_")
            for letter, third in zip("qkv", tensor.chunk(3), strict=True):
                renamed[f"{tower}{before}.self_attn.{letter}_proj.{kind}"] = third
        elif part not in ("logit_scale", "logit_bias", "attn_mask"):
            for old, new in OPEN_CLIP_NAMES:
                part = part.replace(old, new)
            renamed[tower + part] = tensor
    return renamed
