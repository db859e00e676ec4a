"""Small changes of bytes and texts."""

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


def changed_bytes(chance, data, others):
    """Return bytes with a few changes: bits, numbers, lengths, pieces left out, doubled or of another input."""
    data = bytearray(data)
    for _ in range(chance.choice((1, 1, 1, 2, 3, 6))):
        at = chance.randrange(len(data) + 1)
        what = chance.randrange(9)
        if what == 0 and data:
            data[at % len(data)] ^= 1 << chance.randrange(8)
        elif what == 1 and data:
            data[at % len(data)] = chance.choice(NUMBERS) & 0xFF
        elif what <= 4:
            start = at - at % 4 if what == 2 else at
            number = chance.choice(NUMBERS) if chance.random() < 0.7 else chance.randrange(2 * len(data) + 1)
            data[start : start + 4] = number.to_bytes(4, "little")
        elif what == 5:
            del data[at : at + chance.choice((1, 4, 8, 40))]
        elif what == 6:
            del data[at:]
        elif what == 7:
            data[at:at] = data[chance.randrange(len(data) + 1) :][: chance.choice((1, 4, 8, 100))]
        else:
            other = chance.choice(others)
            start = chance.randrange(len(other) + 1)
            data[at:at] = other[start : start + chance.choice((1, 4, 16, 200))]
    return bytes(data)


def changed_text(chance, text, others, tokens=()):
    """Return a text with a few changes: tokens put in, pieces left out, moved, doubled or of another text."""
    text = list(text)
    for _ in range(chance.choice((1, 1, 1, 2, 3, 6))):
        at = chance.randrange(len(text) + 1)
        what = chance.random()
        if what < 0.4:
            own = tokens and chance.random() < 0.6
            text[at:at] = chance.choice(tokens if own else TOKENS)
        elif what < 0.65:
            del text[at : at + chance.choice((1, 1, 2, 4, 12))]
        elif what < 0.8:
            end = at + chance.randint(1, 12)
            other = chance.randrange(len(text) + 1)
            text[other:other] = text[at:end]
        elif what < 0.95:
            other = chance.choice(others)
            start = chance.randrange(len(other) + 1)
            text[at:at] = other[start : start + chance.choice((1, 4, 12, 40))]
        else:
            text[at : at + 1] = text[at : at + 1] * chance.choice((2, 20, 300))
    return "".join(text)


def soup(chance, tokens, most=25):
    """Return a text of tokens."""
    return "".join(chance.choice(tokens) for _ in range(chance.randint(1, most)))


def to_bytes(text):
    """Return the bytes of an input that is text; lone surrogates are kept."""
    return text.encode("utf-8", "surrogatepass")


def to_text(data):
    """Return the text of such an input, or of any bytes."""
    return data.decode("utf-8", "replace" if _is_broken(data) else "surrogatepass")


def _is_broken(data):
    try:
        data.decode("utf-8", "surrogatepass")
    except UnicodeDecodeError:
        return True
    return False
