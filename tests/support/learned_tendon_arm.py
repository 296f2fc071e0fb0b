"""A tendon arm that is seen exactly, and learned from a rough start."""

from tendon_arm import ROUGH, arm, recorded

from softmap_edge.rod.learn import learn


def seen_exactly():
    return recorded(arm(), rate=5.0)


def learned_from_rough(run):
    return learn(run, robot=arm(**ROUGH))
