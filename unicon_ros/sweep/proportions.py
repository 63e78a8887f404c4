"""Proportions: how sure a share of rollouts is, and whether two differ; plain arithmetic."""

from __future__ import annotations

import math

Z95 = 1.959963984540054
"""Of the normal distribution, for 95 %."""


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a share (Wilson 1927); (0, 1) of nothing.

    (p + z²/2n ± z √(p(1-p)/n + z²/4n²)) / (1 + z²/n); right for few hits too, where p ± z σ is not.

    Args:
        hits: how often it happened.
        count: of how many.
    """
    if not count:
        return 0.0, 1.0
    p, z = hits / count, Z95
    middle = p + z * z / (2 * count)
    half = z * math.sqrt(p * (1 - p) / count + z * z / (4 * count * count))
    whole = 1 + z * z / count
    low = 0.0 if not hits else (middle - half) / whole
    return low, 1.0 if hits == count else (middle + half) / whole


def fisher(hits_a: int, count_a: int, hits_b: int, count_b: int) -> float:
    """Return the two-sided p-value of Fisher's exact test that two shares are the same.

    The sum of all tables with the same margins that are at most as likely as this one
    (hypergeometric); 1 where one of both has no rollout.

    Args:
        hits_a, hits_b: how often it happened.
        count_a, count_b: of how many.
    """
    hits, whole = hits_a + hits_b, count_a + count_b

    def log_p(a: int) -> float:
        chosen = _log_choose(count_a, a) + _log_choose(count_b, hits - a)
        return chosen - _log_choose(whole, hits)

    here = log_p(hits_a)
    least, most = max(0, hits - count_b), min(hits, count_a)
    # Equal tables differ in their last digits only: 1e-7 as of R's fisher.test.
    within = [p for a in range(least, most + 1) if (p := log_p(a)) <= here + 1e-7]
    return min(1.0, math.fsum(map(math.exp, within)))


def mcnemar(only_a: int, only_b: int) -> float:
    """Return the two-sided p-value of McNemar's exact test on pairs that differ.

    Twice the smaller tail of a binomial distribution with one half; 1 where no pair differs.

    Args:
        only_a, only_b: pairs in which it happened on that side alone.
    """
    count, fewer = only_a + only_b, min(only_a, only_b)
    least = -count * math.log(2.0)
    tail = math.fsum(math.exp(_log_choose(count, k) + least) for k in range(fewer + 1))
    return min(1.0, 2.0 * tail)


def _log_choose(n: int, k: int) -> float:
    return math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)
