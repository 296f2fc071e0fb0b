"""A run in which nothing is wrong."""

import numpy as np

from softmap_edge.run.run import Run

T, C, K, N = 60, 2, 12, 5


def fields(seed=0):
    """A sound run's fields: home, a corner and home again, thrice; every optional field is set."""
    rng = np.random.default_rng(seed)
    t = np.arange(T) * 0.25
    step = (np.arange(T) // 10) % 2
    rest = np.column_stack([np.zeros(N), np.zeros(N), np.linspace(0, 100, N)])
    return dict(
        t=t,
        command=np.column_stack([8.0 * step, -3.0 * step]),
        present=np.column_stack([7.9 * step, -3.1 * step]),
        current=rng.normal(100, 5, (T, C)),
        temperature=np.full(T, 23.0),
        gravity=np.array([0.0, 0.0, 1.0]),
        load=np.zeros(T),
        t_seen=t[4::5],
        markers=rest + rng.normal(0, 0.1, (K, N, 3)),
        visible=np.ones((K, N), bool),
        sigma=np.array(0.1),
        block=np.arange(K) // 4,
        marker_rest=rest,
        robot="bench finger",
    )


def sound(**change):
    return Run(**(fields() | change))
