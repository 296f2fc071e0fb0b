"""Damage to the bytes of logs."""

from damage import spoil_bytes

LOG = "t,a,b,x,y,z\n" + "".join(f"{k / 10},{k % 3},-{k % 5},{k},{2 * k},7.5\n" for k in range(20))


# --- damage --------------------------------------------------------------------------------
def spoil_binary(sample, folder, rng):
    (folder / sample.name).write_bytes(spoil_bytes(sample.read_bytes(), rng))
    return folder / sample.name


def spoil_counts(sample, folder, rng):
    """Set a few words of the file to the largest, the smallest or a chance number: sizes that
    promise the moon.
    """
    data = bytearray(sample.read_bytes())
    for _ in range(rng.integers(1, 4)):
        size = int(rng.choice([1, 2, 4, 8]))
        # rather at the head, where sizes are
        at = int(rng.random() ** 2 * max(1, len(data) - size))
        words = [b"\xff" * size, b"\0" * size, rng.bytes(size), b"\x7f" + b"\xff" * (size - 1)]
        data[at : at + size] = words[int(rng.integers(4))]
    (folder / sample.name).write_bytes(data)
    return folder / sample.name
