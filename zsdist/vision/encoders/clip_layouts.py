"""Reader of the two folder layouts of CLIP models; both give one form of description.

open_clip: `open_clip_config.json`, `open_clip_model.safetensors`; files of a tokenizer unless it is CLIP's own.
Hugging Face: `config.json`; `model.safetensors`, or the shards that `model.safetensors.index.json` names;
`processor_config.json` (written since transformers 5) or `preprocessor_config.json`; for texts `tokenizer.json`, or
`vocab.json` with `merges.txt`. Nothing is downloaded.
"""

import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from zsdist.errors import WeightsError

Colours = tuple[float, float, float]


class Layout(StrEnum):
    """Library that defines the names of files and weights."""

    OPEN_CLIP = "open_clip"
    HUGGING_FACE = "huggingface"


CONFIG = {Layout.OPEN_CLIP: "open_clip_config.json", Layout.HUGGING_FACE: "config.json"}
WEIGHTS = {Layout.OPEN_CLIP: "open_clip_model.safetensors", Layout.HUGGING_FACE: "model.safetensors"}
INDEX = "model.safetensors.index.json"
PICKLED = ("pytorch_model.bin", "pytorch_model.bin.index.json", "open_clip_pytorch_model.bin")
ALLOWED = "allowed are the layouts " + " and ".join(f"{one} ({CONFIG[one]}, {WEIGHTS[one]})" for one in Layout)

# Defaults of settings that a configuration omits, in the library that wrote it.
OPEN_CLIP_VISION = {
    "layers": 12, "width": 768, "head_width": 64, "mlp_ratio": 4.0, "patch_size": 16, "image_size": 224,
}  # fmt: skip
OPEN_CLIP_TEXT = {
    "layers": 12, "width": 512, "heads": 8, "mlp_ratio": 4.0, "context_length": 77, "vocab_size": 49408,
}  # fmt: skip
OPEN_CLIP_PLAIN = {  # settings that change the computation, with the values of plain towers
    "pool_type": ("tok", "argmax"), "pos_embed_type": ("learnable",), "proj_type": ("linear",),
    "block_type": ("default",),
}  # fmt: skip
OPEN_CLIP_OTHER = (  # settings without effect here
    "patch_dropout", "output_tokens", "attn_pooler_queries", "attn_pooler_heads", "timm_pool", "timm_proj",
    "pad_id", "eos_id", "hf_tokenizer_name", "tokenizer_mode", "tokenizer_kwargs", "hf_model_pretrained",
)  # fmt: skip
HUGGING_FACE_TOWER = {"num_hidden_layers": 12, "layer_norm_eps": 1e-5, "hidden_act": "quick_gelu"}
HUGGING_FACE_VISION = HUGGING_FACE_TOWER | {
    "hidden_size": 768, "num_attention_heads": 12, "intermediate_size": 3072, "patch_size": 32, "image_size": 224,
}  # fmt: skip
HUGGING_FACE_TEXT = HUGGING_FACE_TOWER | {
    "hidden_size": 512, "num_attention_heads": 8, "intermediate_size": 2048, "max_position_embeddings": 77,
    "vocab_size": 49408,
}  # fmt: skip


@dataclass(frozen=True)
class TowerShape:
    """Shape of a transformer; `inner` is the width of a layer's hidden part, `activation` is "gelu" or "quick_gelu"."""

    layers: int
    width: int
    heads: int
    inner: int
    activation: str
    epsilon: float


@dataclass(frozen=True)
class Clip:
    """Description of a CLIP model without its weights.

    Attributes:
        layout: library that defines the names of the weights.
        image_px: side of the images in pixels.
        patch_px: side of a patch in pixels.
        mean: mean of red, green and blue in the training pictures, 0 to 1.
        std: standard deviation of red, green and blue in the training pictures.
        vision: shape of the image tower.
        text: shape of the text tower.
        context: number of tokens of the longest text, begin and end marks included.
        vocabulary: number of different tokens.
        dimensions: number of dimensions of the space that both towers map to.
        standard_tokenizer: whether the tokenizer is the one that CLIP was published with.
    """

    layout: Layout
    image_px: int
    patch_px: int
    mean: Colours
    std: Colours
    vision: TowerShape
    text: TowerShape
    context: int
    vocabulary: int
    dimensions: int
    standard_tokenizer: bool


def read_folder(folder: Path) -> tuple[Clip, tuple[Path, ...]]:
    """Return the description of a folder's model, and the paths of its weights: one file, or several shards.

    Raises:
        WeightsError: a file is missing or damaged, or the model is of an unsupported kind.
    """
    layouts = [layout for layout in Layout if (folder / CONFIG[layout]).is_file()]
    if not layouts:
        raise WeightsError(f"encoder folder {folder} has neither {' nor '.join(CONFIG.values())}; {ALLOWED}")
    layout, weights = next(((one, found) for one in layouts if (found := _weights(folder, one))), (layouts[0], ()))
    path = folder / CONFIG[layout]
    clip = (_open_clip if layout is Layout.OPEN_CLIP else _hugging_face)(path)
    if not weights:
        lacking = " and ".join(WEIGHTS[one] for one in layouts)
        pickled = [name for name in PICKLED if (folder / name).exists()]
        note = f"; {pickled[0]} is not read, since it can run code: save the model as safetensors" if pickled else ""
        raise WeightsError(f"encoder folder {folder} lacks {lacking}{note}; {ALLOWED}")
    if clip.image_px % clip.patch_px or clip.vision.width % clip.vision.heads or clip.text.width % clip.text.heads:
        raise WeightsError(
            f"encoder configuration {path}: image size {clip.image_px} px is no multiple of the patch size "
            f"{clip.patch_px} px, or the width of a tower no multiple of its heads; allowed are multiples"
        )
    return clip, weights


def _weights(folder: Path, layout: Layout) -> tuple[Path, ...]:
    """Return the files of weights of one layout; none where there are none."""
    if (whole := folder / WEIGHTS[layout]).is_file():
        return (whole,)
    index = folder / INDEX
    if layout is Layout.OPEN_CLIP or not index.is_file():
        return ()
    with _blamed(index):
        shards = [folder / Path(name).name for name in sorted(set(_read(index)["weight_map"].values()))]
    if missing := [shard.name for shard in shards if not shard.is_file()]:
        raise WeightsError(f"encoder folder {folder} lacks {', '.join(missing)}, which {INDEX} names")
    return tuple(shards)


@contextmanager
def _blamed(path: Path) -> Iterator[None]:
    """Turn an error in the content of a file into one that names the file."""
    try:
        yield
    except KeyError as error:
        raise WeightsError(f"encoder configuration {path} lacks {error}") from error
    except (AttributeError, TypeError, ValueError) as error:  # a list where an object should be, and the like
        raise WeightsError(f"encoder configuration {path} is damaged: {error}") from error


def _open_clip(path: Path) -> Clip:
    with _blamed(path):
        return _open_clip_model(path, _read(path))


def _open_clip_model(path: Path, about: dict[str, Any]) -> Clip:
    model, preprocessing = about["model_cfg"], about["preprocess_cfg"]
    activation = "quick_gelu" if model.get("quick_gelu") else "gelu"
    towers = {}
    for name, defaults in (("vision_cfg", OPEN_CLIP_VISION), ("text_cfg", OPEN_CLIP_TEXT)):
        for key, value in model[name].items():
            plain = not value or value in OPEN_CLIP_PLAIN.get(key, ())
            if key not in defaults and key not in OPEN_CLIP_OTHER and not plain:
                raise WeightsError(
                    f"encoder configuration {path}: {name}.{key} is {value!r}; allowed are transformers without it"
                )
        towers[name] = defaults | model[name]
    vision, text = towers.values()
    if isinstance(vision["layers"], list):
        raise WeightsError(f"encoder configuration {path}: vision_cfg is of a ResNet; allowed is a vision transformer")
    vision["heads"] = _whole(vision, "width") // _whole(vision, "head_width")
    shapes = []
    for one in (vision, text):
        layers, width, heads = (_whole(one, name) for name in ("layers", "width", "heads"))
        shapes.append(TowerShape(layers, width, heads, int(width * _positive(one, "mlp_ratio")), activation, 1e-5))
    return Clip(
        layout=Layout.OPEN_CLIP,
        image_px=_side(vision["image_size"]),
        patch_px=_side(vision["patch_size"]),
        mean=_colours(preprocessing, "mean"),
        std=_colours(preprocessing, "std"),
        vision=shapes[0],
        text=shapes[1],
        context=_whole(text, "context_length"),
        vocabulary=_whole(text, "vocab_size"),
        dimensions=_whole(model, "embed_dim"),
        standard_tokenizer=not (text.get("hf_tokenizer_name") or text.get("tokenizer_kwargs")),
    )


def _hugging_face(path: Path) -> Clip:
    with _blamed(path):
        about = _read(path)
        if about.get("model_type") != "clip":
            alone = str(about.get("model_type")).startswith("clip_")
            raise WeightsError(
                f"encoder configuration {path}: model_type is {about.get('model_type')!r}; allowed is 'clip'"
                + (", with both towers: save the whole CLIPModel" if alone else "")
            )
        vision, text = (
            defaults | (about.get(name) or {})
            for name, defaults in (("vision_config", HUGGING_FACE_VISION), ("text_config", HUGGING_FACE_TEXT))
        )
        vision_shape, text_shape = (
            TowerShape(
                _whole(one, "num_hidden_layers"),
                _whole(one, "hidden_size"),
                _whole(one, "num_attention_heads"),
                _whole(one, "intermediate_size"),
                one["hidden_act"],
                _positive(one, "layer_norm_eps"),
            )
            for one in (vision, text)
        )
        context, vocabulary = _whole(text, "max_position_embeddings"), _whole(text, "vocab_size")
        dimensions = _whole({"projection_dim": 512} | about, "projection_dim")
        sizes = _side(vision["image_size"]), _side(vision["patch_size"])
    for shape in (vision_shape, text_shape):
        if shape.activation not in ("gelu", "quick_gelu"):
            raise WeightsError(
                f"encoder configuration {path}: hidden_act is {shape.activation!r}; allowed are 'gelu' and 'quick_gelu'"
            )
    mean, std = _preprocessing(path.parent, sizes[0])
    return Clip(
        layout=Layout.HUGGING_FACE,
        image_px=sizes[0],
        patch_px=sizes[1],
        mean=mean,
        std=std,
        vision=vision_shape,
        text=text_shape,
        context=context,
        vocabulary=vocabulary,
        dimensions=dimensions,
        standard_tokenizer=False,
    )


def _preprocessing(folder: Path, image_px: int) -> tuple[Colours, Colours]:
    """Return mean and standard deviation of the colours, 0 to 1, from the file that transformers would read.

    Pictures are made squares of `image_px`, whatever size the file gives; one that crops to another is refused.
    """
    new, old = folder / "processor_config.json", folder / "preprocessor_config.json"
    about, path = None, new
    if new.is_file():
        with _blamed(new):
            about = _read(new).get("image_processor")  # absent where an older version wrote the file
    if about is None and old.is_file():
        about, path = _read(old), old
    if about is None:
        raise WeightsError(
            f"encoder folder {folder} lacks {old.name}, or {new.name} with an image_processor: they have the mean of "
            "the colours"
        )
    with _blamed(path):
        if not about.get("do_normalize", True):
            mean, std = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
        else:
            mean, std = _colours(about, "image_mean"), _colours(about, "image_std")
        crop = about.get("crop_size", image_px) if about.get("do_center_crop", True) else image_px
        sides = [crop.get("height"), crop.get("width")] if isinstance(crop, dict) else [crop]
        if set(sides) != {image_px}:
            raise WeightsError(
                f"encoder configuration {path}: crop_size is {crop!r}; allowed is the model's image_size, {image_px}"
            )
        factor = about.get("rescale_factor", 1 / 255) if about.get("do_rescale", True) else 1.0
        if not math.isclose(factor, 1 / 255, rel_tol=1e-3):
            raise WeightsError(
                f"encoder configuration {path}: rescale_factor is {factor:g}; allowed is 1/255, {1 / 255:g}"
            )
    return mean, std


def _read(path: Path) -> dict[str, Any]:
    with _blamed(path):
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise WeightsError(f"encoder configuration {path} cannot be read: {error.strerror}") from error
        if not isinstance(content, dict):
            raise ValueError("it is no object")
        return content


def _side(size: object) -> int:
    """Return the side of a square, given as a number or as a list of equal numbers."""
    sides = set(size) if isinstance(size, list) else {size}
    side = sides.pop() if len(sides) == 1 else None
    if not isinstance(side, int) or side <= 0:
        raise ValueError(f"a size is {size!r}; allowed is the size of a square, in pixels")
    return side


def _colours(about: dict[str, Any], name: str) -> Colours:
    values = about[name]
    if not (isinstance(values, list) and len(values) == 3 and all(map(_is_number, values))):
        raise ValueError(f"{name} is {values!r}; allowed are three numbers")
    red, green, blue = map(float, values)
    return red, green, blue


def _whole(about: dict[str, Any], name: str) -> int:
    if not (_is_number(value := about[name]) and value == int(value) > 0):
        raise ValueError(f"{name} is {value!r}; allowed is a positive whole number")
    return int(value)


def _positive(about: dict[str, Any], name: str) -> float:
    if not (_is_number(value := about[name]) and value > 0):
        raise ValueError(f"{name} is {value!r}; allowed is a positive number")
    return float(value)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
