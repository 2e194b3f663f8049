"""Seeds: their valid values, and the seed of each stage, derived from that of its config."""

from __future__ import annotations

from hashlib import sha256

GREATEST_SEED = 2**63 - 1


def derive_seed(root: int, label: str) -> int:
    """Return the seed of the stage `label` of a config whose seed is `root`.

    >>> derive_seed(7, "jitter") == derive_seed(7, "jitter") != derive_seed(7, "jitter.2")
    True
    """
    return int.from_bytes(sha256(f"{root}:{label}".encode()).digest()[:8], "big")


def seed_fault(seed: object) -> str | None:
    """Return the fault of an invalid `seed`, or None.

    >>> seed_fault(-1)
    'seed: must be a whole number from 0 to 2^63 - 1, got -1'
    """
    if isinstance(seed, int) and not isinstance(seed, bool) and 0 <= seed <= GREATEST_SEED:
        return None
    return f"seed: must be a whole number from 0 to 2^63 - 1, got {seed!r}"
