"""Tiny CLIP models with random weights, written to folders by the libraries that publish CLIP."""

import json
from functools import partial

import declared_operators  # noqa: F401 (before open_clip, which imports torchvision)
import numpy as np
import open_clip
import torch
import transformers
from safetensors.torch import save_file

PX, PATCH, DIMENSIONS, CONTEXT = 48, 16, 8, 12
MEAN, STD = (0.48, 0.45, 0.4), (0.27, 0.26, 0.28)
WIDTHS = {"vision": 32, "text": 24}
BEGIN, END = "<|startoftext|>", "<|endoftext|>"
LETTERS = "abcdefghijklmnopqrstuvwxyz,."
PAIRS = [("t", "r"), ("e", "e</w>"), ("tr", "ee</w>"), ("r", "o"), ("c", "k</w>"), ("ro", "ck</w>")]


def vocabulary():
    words = [*LETTERS, *(letter + "</w>" for letter in LETTERS), *("".join(pair) for pair in PAIRS), BEGIN, END]
    return {word: index for index, word in enumerate(words)}


def tokenizer():
    return transformers.CLIPTokenizer(vocab=vocabulary(), merges=PAIRS)


def randomised(model):
    """Set fixed random weights, nowhere zero or one, so that a test notices each missing or swapped one."""
    generator = torch.Generator().manual_seed(5)
    with torch.no_grad():
        for name, parameter in model.named_parameters():
            around = 1.0 if parameter.ndim == 1 and "weight" in name else 0.0  # normalisations
            parameter.copy_(around + 0.2 * torch.randn(parameter.shape, generator=generator))
    return model.eval()


def hugging_face(folder, **changes):
    """Write a model in the layout of Hugging Face, as transformers 4 did, and return it."""
    model = made(**changes)
    model.save_pretrained(folder)
    about = {"image_mean": MEAN, "image_std": STD, "crop_size": {"height": PX, "width": PX}}
    (folder / "preprocessor_config.json").write_text(json.dumps(about))
    tokenizer().save_pretrained(folder)
    return model


def transformers_5(folder, max_shard_size="1GB"):
    """Write a model as `CLIPModel` and `CLIPProcessor` of transformers 5 save themselves, and return it."""
    model = made()
    model.save_pretrained(folder, max_shard_size=max_shard_size)
    crop, shortest = {"height": PX, "width": PX}, {"shortest_edge": PX}
    processor = transformers.CLIPImageProcessor(image_mean=MEAN, image_std=STD, crop_size=crop, size=shortest)
    transformers.CLIPProcessor(processor, tokenizer()).save_pretrained(folder)
    return model


def tower_alone(folder, name):
    """Write one tower with its projection, of the class `name` of transformers."""
    model = made()
    tower = getattr(transformers, name)
    tower(model.config.vision_config if "Vision" in name else model.config.text_config).save_pretrained(folder)


def default_configuration():
    """Return the configuration of a model of which nothing is stated."""
    return transformers.CLIPConfig()


def made(**changes):
    """Return a tiny model of transformers; `changes` are those of the image tower."""
    tower = {"num_hidden_layers": 2, "num_attention_heads": 4, "intermediate_size": 40, "projection_dim": DIMENSIONS}
    words = vocabulary()
    config = transformers.CLIPConfig(
        vision_config=tower | {"hidden_size": WIDTHS["vision"], "image_size": PX, "patch_size": PATCH} | changes,
        text_config=tower
        | {"hidden_size": WIDTHS["text"], "vocab_size": len(words), "max_position_embeddings": CONTEXT}
        | {"bos_token_id": words[BEGIN], "eos_token_id": words[END], "pad_token_id": words[END]},
        projection_dim=DIMENSIONS,
    )
    return randomised(transformers.CLIPModel(config))


def of_open_clip(folder, *, separate=False, standard_tokenizer=False, quick_gelu=False, **changes):
    """Write a model in the layout of open_clip and return it."""
    words = 49408 if standard_tokenizer else len(vocabulary())
    about = {
        "embed_dim": DIMENSIONS,
        "quick_gelu": quick_gelu,
        "vision_cfg": {"layers": 2, "width": WIDTHS["vision"], "head_width": 8, "patch_size": PATCH, "image_size": PX},
        "text_cfg": {"layers": 2, "width": WIDTHS["text"], "heads": 4, "context_length": CONTEXT, "vocab_size": words},
    }
    about["vision_cfg"] |= changes
    model = randomised((open_clip.CustomTextCLIP if separate else open_clip.CLIP)(**about))
    save_file({name: tensor.contiguous() for name, tensor in model.state_dict().items()}, weights_of(folder))
    config = {"model_cfg": about, "preprocess_cfg": {"mean": MEAN, "std": STD, "interpolation": "bicubic"}}
    (folder / "open_clip_config.json").write_text(json.dumps(config))
    if not standard_tokenizer:
        tokenizer().save_pretrained(folder)
    return model


def weights_of(folder):
    return folder / "open_clip_model.safetensors"


def pixels(images):
    """Return images in the form that both libraries take."""
    scaled = (images.astype(np.float32) / 255 - np.array(MEAN, np.float32)) / np.array(STD, np.float32)
    return torch.from_numpy(scaled).permute(0, 3, 1, 2)


def grid(tokens):
    side = PX // PATCH
    return tokens.reshape(len(tokens), side, side, -1).numpy()


@torch.no_grad()
def library_tokens(model, images):
    """Return the patches after the last norm from the library's own forward."""
    if isinstance(model, transformers.CLIPModel):
        hidden = model.vision_model(pixels(images)).last_hidden_state
        return grid(model.vision_model.post_layernorm(hidden)[:, 1:])
    model.visual.output_tokens = True
    _, tokens = model.visual(pixels(images))
    return grid(tokens)


@torch.no_grad()
def library_images(model, images):
    if isinstance(model, transformers.CLIPModel):
        return model(pixel_values=pixels(images), input_ids=torch.tensor([[0]])).image_embeds.numpy()
    model.visual.output_tokens = False
    return model.encode_image(pixels(images), normalize=True).numpy()


@torch.no_grad()
def library_texts(model, texts, words=None):
    """Return embeddings of texts from the library's own forward, padded to the whole context as it does."""
    if isinstance(model, transformers.CLIPModel):
        ids = tokenizer()(texts, padding="max_length", truncation=True, max_length=CONTEXT, return_tensors="pt")
        dot = torch.zeros(1, 3, PX, PX)
        return model(pixel_values=dot, **ids).text_embeds.numpy()
    return model.encode_text((words or own_words)(texts), normalize=True).numpy()


def own_words(texts):
    """Return token numbers of the tiny tokenizer, padded as in open_clip."""
    ids = torch.zeros(len(texts), CONTEXT, dtype=torch.long)
    for row, text in zip(ids, texts, strict=True):
        found = tokenizer()(text, truncation=True, max_length=CONTEXT)["input_ids"]
        row[: len(found)] = torch.tensor(found)
    return ids


MAKERS = {"open_clip": of_open_clip, "huggingface": hugging_face}  # one for each layout
SHARDED = partial(transformers_5, max_shard_size="20KB")
ALL_MAKERS = MAKERS | {"transformers 5": transformers_5, "shards": SHARDED}
