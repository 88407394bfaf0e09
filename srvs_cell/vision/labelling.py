"""Which of a few labels each node of a graph takes: Potts' model, minimised by belief propagation.

The energy is the sum of the nodes' own costs and, for every edge whose ends differ, the edge's weight (Potts 1952).
Min-sum belief propagation (Felzenszwalb and Huttenlocher, IJCV 70, 2006) sends along each edge what the one end knows
against each label, at most the edge's weight. On a graph with loops it is an approximation; it stops where the labels
no longer change, and what it found is polished node by node, which can only lower the energy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array

_DAMPING = 0.5
_CHECKED_EVERY = 4
_POLISHINGS = 4


def choose_labels(
    cost: Array, one: NDArray[np.intp], other: NDArray[np.intp], weight: Array, iterations: int
) -> NDArray[np.intp]:
    """Return a label for every node.

    Args:
        cost: of each label at each node, shape (K, N).
        one: the one end of each edge, shape (E,), each edge once.
        other: its other end, shape (E,).
        weight: what an edge costs whose ends differ, shape (E,).
        iterations: greatest number of rounds of messages.
    """
    labels = np.asarray(np.argmin(cost, axis=0))
    if len(cost) == 1 or not one.size:
        return labels
    edges = _Edges.of(one, other, weight)
    own = cost.astype(np.float32)
    messages = np.zeros((len(cost), edges.source.size), dtype=np.float32)
    belief = own
    for iteration in range(iterations):
        fresh = belief.take(edges.source, axis=1)
        fresh -= messages.take(edges.back, axis=1)
        fresh -= fresh.min(axis=0)
        np.minimum(fresh, edges.limit, out=fresh)
        fresh -= messages
        fresh *= np.float32(1.0 - _DAMPING)
        messages += fresh
        belief = own + edges.gathered(messages, own.shape[1])
        if iteration % _CHECKED_EVERY == _CHECKED_EVERY - 1:
            before, labels = labels, np.asarray(np.argmin(belief, axis=0))
            if np.array_equal(before, labels):
                break
    return _polished(own, np.asarray(np.argmin(belief, axis=0)), edges)


@dataclass(frozen=True, eq=False)
class _Edges:
    """Every edge in both directions, sorted by where it leads to.

    Attributes:
        source: where it comes from, shape (2E,).
        back: the number of the same edge the other way.
        limit: its weight.
        reached: the nodes that edges lead to, ascending.
        start: the first edge to each of them.
    """

    source: NDArray[np.intp]
    back: NDArray[np.intp]
    limit: NDArray[np.float32]
    reached: NDArray[np.intp]
    start: NDArray[np.intp]

    @classmethod
    def of(cls, one: NDArray[np.intp], other: NDArray[np.intp], weight: Array) -> _Edges:
        target, source = np.concatenate([other, one]), np.concatenate([one, other])
        order = np.argsort(target, kind="stable")
        place = np.empty(order.size, dtype=np.intp)
        place[order] = np.arange(order.size)
        reached, start = np.unique(target[order], return_index=True)
        return cls(
            source[order],
            place[(order + one.size) % order.size],
            np.concatenate([weight, weight])[order].astype(np.float32),
            reached,
            start,
        )

    def gathered(self, messages: NDArray[np.float32], nodes: int) -> NDArray[np.float32]:
        """Return the sum of what arrives at each node, shape (K, nodes)."""
        total = np.zeros((len(messages), nodes), dtype=np.float32)
        total[:, self.reached] = np.add.reduceat(messages, self.start, axis=1)
        return total


def _polished(cost: NDArray[np.float32], labels: NDArray[np.intp], edges: _Edges) -> NDArray[np.intp]:
    """Give nodes the label that is best beside their neighbours', every other node at a time."""
    number = np.arange(labels.size)
    for turn in range(_POLISHINGS):
        agreeing = np.zeros((len(cost), edges.source.size), dtype=np.float32)
        agreeing[labels[edges.source], np.arange(edges.source.size)] = edges.limit
        total = cost - edges.gathered(agreeing, labels.size)
        best = np.argmin(total, axis=0)
        # neighbours that change at once could make it worse: half of the nodes, by turns
        better = (total[best, number] < total[labels, number]) & (number % 2 == turn % 2)
        labels = np.where(better, best, labels)
    return labels
