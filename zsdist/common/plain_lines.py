"""Lines of output that are shown as they are, whatever they contain; `console` shows more, and needs rich for it."""

import sys
import unicodedata

_UNSEEN = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}  # Unicode categories without a picture of their own
_JOINERS = "\u200c\u200d"  # format characters that emoji and several scripts need, and that move nothing


def plain(text: object) -> str:
    r"""Return a text in one line: control, format and undecodable characters become escapes such as `\n` or `\x1b`.

    A byte of a file name that is no UTF-8 becomes `\xff`. Everything else stays, backslashes too.
    """
    shown = str(text)
    return shown if shown.isascii() and shown.isprintable() else "".join(map(_plain, shown))


def _plain(character: str) -> str:
    if character in _JOINERS or unicodedata.category(character) not in _UNSEEN:
        return character
    byte = ord(character) - 0xDC00
    if 0x80 <= byte <= 0xFF:  # Python's stand-in for a byte that is no UTF-8
        return f"\\x{byte:02x}"
    return character.encode("unicode_escape").decode()


def say(text: object, *, error: bool = False) -> None:
    """Print a text as one plain line to standard output or standard error, at once."""
    file = sys.stderr if error else sys.stdout
    line = plain(text)
    encoding = getattr(file, "encoding", None) or "utf-8"
    print(line.encode(encoding, "backslashreplace").decode(encoding), file=file, flush=True)
