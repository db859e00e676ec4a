"""Small changes of bytes and texts."""

from typing import Any

NUMBERS = (
    0,
    1,
    2,
    3,
    7,
    0x7F,
    0x80,
    0xFF,
    0x7FFF,
    0xFFFF,
    1 << 20,
    0x7FFFFFFF,
    0x80000000,
    0xFFFFFFFE,
    0xFFFFFFFF,
)
TOKENS = list("()[]{},|.'\"`\\;:!%/*-+<>=@#&^~?_$ \n\t\r0123456789abcXYZé∀\0\u2028\U0001f600")


def mutate_bytes(rng: Any, data: Any, others: Any) -> bytes:
    """Return bytes with a few changes: bits, numbers and lengths; pieces that are removed, repeated or inserted."""
    data = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        position = rng.randrange(len(data) + 1)
        choice = rng.randrange(9)
        if choice == 0 and data:
            data[position % len(data)] ^= 1 << rng.randrange(8)
        elif choice == 1 and data:
            data[position % len(data)] = rng.choice(NUMBERS) & 0xFF
        elif choice <= 4:
            start = position - position % 4 if choice == 2 else position
            number = rng.choice(NUMBERS) if rng.random() < 0.7 else rng.randrange(2 * len(data) + 1)
            data[start : start + 4] = number.to_bytes(4, "little")
        elif choice == 5:
            del data[position : position + rng.choice((1, 4, 8, 40))]
        elif choice == 6:
            del data[position:]
        elif choice == 7:
            data[position:position] = data[rng.randrange(len(data) + 1) :][: rng.choice((1, 4, 8, 100))]
        else:
            other = rng.choice(others)
            start = rng.randrange(len(other) + 1)
            data[position:position] = other[start : start + rng.choice((1, 4, 16, 200))]
    return bytes(data)


def mutate_text(rng: Any, text: Any, others: Any, tokens: Any = ()) -> str:
    """Return a text with a few changes: inserted tokens; pieces that are removed, moved, repeated or inserted."""
    text = list(text)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        position = rng.randrange(len(text) + 1)
        choice = rng.random()
        if choice < 0.4:
            use_own_tokens = tokens and rng.random() < 0.6
            text[position:position] = rng.choice(tokens if use_own_tokens else TOKENS)
        elif choice < 0.65:
            del text[position : position + rng.choice((1, 1, 2, 4, 12))]
        elif choice < 0.8:
            end = position + rng.randint(1, 12)
            other = rng.randrange(len(text) + 1)
            text[other:other] = text[position:end]
        elif choice < 0.95:
            other = rng.choice(others)
            start = rng.randrange(len(other) + 1)
            text[position:position] = other[start : start + rng.choice((1, 4, 12, 40))]
        else:
            text[position : position + 1] = text[position : position + 1] * rng.choice((2, 20, 300))
    return "".join(text)


def random_tokens(rng: Any, tokens: Any, max_tokens: int = 25) -> str:
    """Return a text of random tokens."""
    return "".join(rng.choice(tokens) for _ in range(rng.randint(1, max_tokens)))


def to_bytes(text: Any) -> bytes:
    """Return the bytes of an input that is text; lone surrogates are encoded, too."""
    return text.encode("utf-8", "surrogatepass")


def to_text(data: Any) -> str:
    """Return the text of such an input; invalid bytes are replaced."""
    return data.decode("utf-8", "replace" if _is_broken(data) else "surrogatepass")


def _is_broken(data: Any) -> bool:
    try:
        data.decode("utf-8", "surrogatepass")
    except UnicodeDecodeError:
        return True
    return False
