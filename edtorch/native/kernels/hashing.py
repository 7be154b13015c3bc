"""``edtorch.run.hashing`` for one number: the same bits."""


@inner
def mix(word):
    """A bijection of [0, 2^32)."""
    word ^= word >> 16
    word = (word * 0x21F0AAAD) & 0xFFFFFFFF
    word ^= word >> 15
    word = (word * 0x735A2D97) & 0xFFFFFFFF
    return word ^ (word >> 15)


@inner
def hashed(first, second, counter):
    """The uniform number of a key at ``counter`` times the numbers of a tick, plus its place."""
    return mix((mix((counter & 0xFFFFFFFF) ^ first) + second) & 0xFFFFFFFF) * 2.0**-32
