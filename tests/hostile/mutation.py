"""Damage to the bytes of a file: flipped, inserted, cut out, moved, repeated, cut off."""

# Values at which length fields, types and signs go wrong.
_ODD_BYTES = (0x00, 0x01, 0x7F, 0x80, 0xFE, 0xFF, 0x0A, 0x22, 0x2C, 0x5B, 0x7B)
_ODD_WORDS = (0, 1, 2**31 - 1, 2**31, 2**32 - 1, 2**16, 2**24)


def _flip(data, rng):
    for _ in range(int(rng.integers(1, 5))):
        data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))


def _odd(data, rng):
    for _ in range(int(rng.integers(1, 4))):
        data[int(rng.integers(len(data)))] = int(rng.choice(_ODD_BYTES))


def _word(data, rng):
    at = int(rng.integers(max(1, len(data) - 4)))
    word = int(rng.choice(_ODD_WORDS))
    data[at : at + 4] = word.to_bytes(4, "little" if rng.random() < 0.8 else "big")


def _insert(data, rng):
    at = int(rng.integers(len(data) + 1))
    data[at:at] = rng.bytes(int(rng.integers(1, 20)))


def _delete(data, rng):
    at = int(rng.integers(len(data)))
    del data[at : at + int(rng.integers(1, 40))]


def _splice(data, rng):
    a, b = sorted(rng.integers(len(data), size=2).tolist())
    piece = data[a : min(b, a + 200)]
    at = int(rng.integers(len(data)))
    data[at : at + len(piece)] = piece


def _repeat(data, rng):
    at = int(rng.integers(len(data)))
    data[at:at] = data[at : at + int(rng.integers(1, 60))] * int(rng.integers(1, 20))


def _truncate(data, rng):
    del data[int(rng.integers(len(data))) :]


_WAYS = (_flip, _odd, _word, _insert, _delete, _splice, _repeat, _truncate)


def mutated(data, rng, near=None):
    """Damage a file in one to three ways.

    ``near`` is how many of its first and last bytes are damaged more often: that is where
    binary formats say what they hold.
    """
    data = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        if not data:
            break
        way = _WAYS[int(rng.integers(len(_WAYS)))]
        if near is not None and way is not _truncate and len(data) > 2 * near:
            kind = rng.random()
            if kind < 0.3:
                part = data[:near]
                way(part, rng)
                data[:near] = part
                continue
            if kind < 0.6:
                part = data[-near:]
                way(part, rng)
                data[-near:] = part
                continue
        way(data, rng)
    return bytes(data)
