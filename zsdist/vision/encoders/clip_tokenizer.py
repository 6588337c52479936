"""Tokenizer of a CLIP folder, built with the `tokenizers` library alone."""

import gzip
import json
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from zsdist.errors import WeightsError
from zsdist.vision.encoders.clip_layouts import Clip, Layout

if TYPE_CHECKING:
    from tokenizers import Tokenizer

STANDARD_VOCABULARY = 49408
STANDARD_FILE = "bpe_simple_vocab_16e6.txt.gz"  # the byte pairs that CLIP merges, in the package open_clip_torch
WORDS = r"'s|'t|'re|'ve|'m|'ll|'d|[\p{L}]+|[\p{N}]|[^\s\p{L}\p{N}]+"
"""Parts of a text before pairs are merged: endings, words, single digits, runs of other signs."""


def read_tokenizer(folder: Path, clip: Clip) -> tuple["Tokenizer", int]:
    """Return the folder's tokenizer, which truncates and pads texts, and the number of the token that ends a text.

    `tokenizer.json` takes precedence over `vocab.json` with `merges.txt`. An open_clip folder may have neither: its
    standard vocabulary is in the package open_clip_torch.

    Raises:
        WeightsError: a file or a package is missing or damaged, or the vocabulary does not fit the model.
    """
    try:
        from tokenizers import Tokenizer
    except ImportError as error:
        raise WeightsError("package tokenizers is not installed; run `pip install tokenizers`") from error
    path = folder / "tokenizer.json"
    try:
        if path.is_file():
            tokenizer = Tokenizer.from_file(str(path))
        elif (path := folder / "vocab.json").is_file() and (folder / "merges.txt").is_file():
            lines = (folder / "merges.txt").read_text(encoding="utf-8").splitlines()
            pairs = [_pair(line) for line in lines if line and not line.startswith("#version")]
            tokenizer = _byte_pairs(
                json.loads(path.read_text(encoding="utf-8")), pairs, "<|startoftext|>", "<|endoftext|>"
            )
        elif clip.standard_tokenizer and clip.vocabulary == STANDARD_VOCABULARY:
            path = _standard_file(folder)
            tokenizer = _standard(path)
        else:
            raise WeightsError(
                f"encoder folder {folder} lacks a tokenizer, which texts need; "
                "allowed is tokenizer.json, or vocab.json with merges.txt"
            )
        ends = tokenizer.encode("").ids
    except WeightsError:
        raise
    except Exception as error:  # the tokenizers library raises `Exception` itself
        raise WeightsError(f"tokenizer {path} is damaged: {' '.join(str(error).split())[:200]}") from error
    if len(ends) != 2 or tokenizer.get_vocab_size() > clip.vocabulary:
        raise WeightsError(
            f"tokenizer {path} has {tokenizer.get_vocab_size()} words and puts {len(ends)} marks around a text; "
            f"allowed are at most {clip.vocabulary} words and exactly 2 marks"
        )
    if clip.layout is Layout.OPEN_CLIP and ends[-1] != max(tokenizer.get_vocab().values()):
        raise WeightsError(f"tokenizer {path} ends texts with {ends[-1]}; allowed is its largest number (open_clip)")
    tokenizer.enable_truncation(clip.context)
    tokenizer.enable_padding(pad_id=ends[-1])
    return tokenizer, ends[-1]


def _pair(line: str) -> tuple[str, str]:
    first, second = line.split()
    return first, second


def _byte_pairs(vocabulary: dict[str, int], pairs: list[tuple[str, str]], begin: str, end: str) -> "Tokenizer":
    """Return a byte-pair tokenizer of lower-cased words that puts a begin mark and an end mark around a text."""
    from tokenizers import Regex, Tokenizer, models, normalizers, pre_tokenizers, processors

    tokenizer = Tokenizer(models.BPE(vocabulary, pairs, unk_token=end, end_of_word_suffix="</w>"))
    spaces = normalizers.Replace(Regex(r"\s+"), " ")
    tokenizer.normalizer = normalizers.Sequence([normalizers.NFC(), spaces, normalizers.Lowercase()])
    words = pre_tokenizers.Split(Regex(WORDS), behavior="removed", invert=True)
    tokenizer.pre_tokenizer = pre_tokenizers.Sequence([words, pre_tokenizers.ByteLevel(add_prefix_space=False)])
    tokenizer.post_processor = processors.RobertaProcessing(
        (end, vocabulary[end]), (begin, vocabulary[begin]), trim_offsets=False, add_prefix_space=False
    )
    return tokenizer


def _standard_file(folder: Path) -> Path:
    found = find_spec("open_clip")
    if found is None or found.origin is None:
        raise WeightsError(
            f"encoder folder {folder} lacks tokenizer.json, and package open_clip_torch, which has the standard "
            "vocabulary, is not installed; run `pip install open_clip_torch`"
        )
    return Path(found.origin).with_name(STANDARD_FILE)


def _standard(path: Path) -> "Tokenizer":
    """Return CLIP's own tokenizer. Its tokens are bytes, bytes that end a word, merged pairs, and the two marks."""
    printable = [*range(ord("!"), ord("~") + 1), *range(ord("¡"), ord("¬") + 1), *range(ord("®"), ord("ÿ") + 1)]
    signs = [chr(byte) for byte in printable] + [chr(256 + index) for index in range(256 - len(printable))]
    begin, end = "<start_of_text>", "<end_of_text>"
    count = STANDARD_VOCABULARY - 2 * len(signs) - 2
    with gzip.open(path, "rt", encoding="utf-8") as lines:
        next(lines)  # the version
        pairs = [_pair(line) for _, line in zip(range(count), lines, strict=False)]
    words = [*signs, *(sign + "</w>" for sign in signs), *("".join(pair) for pair in pairs), begin, end]
    return _byte_pairs({word: index for index, word in enumerate(words)}, pairs, begin, end)
