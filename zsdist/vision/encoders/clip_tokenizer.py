"""The tokenizer of a CLIP folder, by the `tokenizers` library alone."""

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
STANDARD_FILE = "bpe_simple_vocab_16e6.txt.gz"  # the pairs that CLIP joins, in the package open_clip_torch
WORDS = r"'s|'t|'re|'ve|'m|'ll|'d|[\p{L}]+|[\p{N}]|[^\s\p{L}\p{N}]+"
"""What a text is cut into before pairs are joined: endings, words, single digits, runs of other signs."""


def read_tokenizer(folder: Path, clip: Clip) -> tuple["Tokenizer", int]:
    """The folder's tokenizer, cutting and padding texts to one length, and the number that ends a text.

    `tokenizer.json` goes before `vocab.json` with `merges.txt`; an open_clip folder may have neither, as its standard
    vocabulary is in the package open_clip_torch.

    Raises:
        WeightsError: a file or a package is missing or damaged, or the vocabulary is not the model's.
    """
    try:
        from tokenizers import Tokenizer
    except ImportError as error:
        raise WeightsError("package tokenizers is not installed; `pip install tokenizers` brings it") from error
    path = folder / "tokenizer.json"
    try:
        if path.is_file():
            tokenizer = Tokenizer.from_file(str(path))
        elif (path := folder / "vocab.json").is_file() and (folder / "merges.txt").is_file():
            lines = (folder / "merges.txt").read_text().splitlines()
            pairs = [tuple(line.split()) for line in lines if line and not line.startswith("#version")]
            tokenizer = _byte_pairs(json.loads(path.read_text()), pairs, "<|startoftext|>", "<|endoftext|>")
        elif clip.standard_tokenizer and clip.vocabulary == STANDARD_VOCABULARY:
            path = _standard_file(folder)
            tokenizer = _standard(path)
        else:
            raise WeightsError(
                f"encoder folder {folder} lacks a tokenizer, which texts need; "
                "allowed are tokenizer.json, or vocab.json with merges.txt"
            )
        ends = tokenizer.encode("").ids
    except WeightsError:
        raise
    except Exception as error:  # the tokenizers library raises this very class
        raise WeightsError(f"tokenizer {path} is damaged: {' '.join(str(error).split())[:200]}") from error
    if len(ends) != 2 or tokenizer.get_vocab_size() > clip.vocabulary:
        raise WeightsError(
            f"tokenizer {path} has {tokenizer.get_vocab_size()} words and puts {len(ends)} marks around a text; "
            f"allowed are {clip.vocabulary} or fewer, and 2"
        )
    if clip.layout is Layout.OPEN_CLIP and ends[-1] != max(tokenizer.get_vocab().values()):
        raise WeightsError(f"tokenizer {path} ends texts by {ends[-1]}; allowed is its largest number, as in open_clip")
    tokenizer.enable_truncation(clip.context)
    tokenizer.enable_padding(pad_id=ends[-1])
    return tokenizer, ends[-1]


def _byte_pairs(vocabulary: dict[str, int], pairs: list[tuple[str, str]], begin: str, end: str) -> "Tokenizer":
    """Byte pairs joined in words of small letters, between two marks."""
    from tokenizers import Regex, Tokenizer, models, normalizers, pre_tokenizers, processors

    tokenizer = Tokenizer(models.BPE(vocabulary, pairs, unk_token=end, end_of_word_suffix="</w>"))
    spaces = normalizers.Replace(Regex(r"\s+"), " ")
    tokenizer.normalizer = normalizers.Sequence([normalizers.NFC(), spaces, normalizers.Lowercase()])
    words = pre_tokenizers.Split(Regex(WORDS), behavior="removed", invert=True)
    tokenizer.pre_tokenizer = pre_tokenizers.Sequence([words, pre_tokenizers.ByteLevel(add_prefix_space=False)])
    marks = [(mark, vocabulary[mark]) for mark in (end, begin)]
    tokenizer.post_processor = processors.RobertaProcessing(*marks, trim_offsets=False, add_prefix_space=False)
    return tokenizer


def _standard_file(folder: Path) -> Path:
    found = find_spec("open_clip")
    if found is None or found.origin is None:
        raise WeightsError(
            f"encoder folder {folder} lacks tokenizer.json, and package open_clip_torch, which has the standard "
            "vocabulary, is not installed; `pip install open_clip_torch` brings it"
        )
    return Path(found.origin).with_name(STANDARD_FILE)


def _standard(path: Path) -> "Tokenizer":
    """CLIP's own vocabulary: bytes, bytes that end a word, then what each pair makes, then the two marks."""
    printable = [*range(ord("!"), ord("~") + 1), *range(ord("¡"), ord("¬") + 1), *range(ord("®"), ord("ÿ") + 1)]
    signs = [chr(byte) for byte in printable] + [chr(256 + index) for index in range(256 - len(printable))]
    begin, end = "<start_of_text>", "<end_of_text>"
    count = STANDARD_VOCABULARY - 2 * len(signs) - 2
    with gzip.open(path, "rt", encoding="utf-8") as lines:
        next(lines)  # its version
        pairs = [tuple(line.split()) for _, line in zip(range(count), lines, strict=False)]
    words = [*signs, *(sign + "</w>" for sign in signs), *("".join(pair) for pair in pairs), begin, end]
    return _byte_pairs({word: index for index, word in enumerate(words)}, pairs, begin, end)
