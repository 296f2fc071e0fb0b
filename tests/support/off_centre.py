"""A finger whose spools turn off their middle: exact geometry of winding, which no effect of the
library is.
"""

from functools import lru_cache

from softmap_edge.comparison.comparison import compare
from softmap_edge.model.bundle import builtin_model
from softmap_edge.run.protocol import other_protocol, standard_protocol
from softmap_edge.synthetic.finger import hide


@lru_cache(maxsize=1)
def story(seed=4):
    """Return a run of that finger, a run of another kind, and the error there of the model with
    nothing hidden.
    """
    hidden = hide(["off_centre_spool"], seed)
    judge = other_protocol(2)
    floor = compare(builtin_model(), hidden.twin().measure(judge, seed=1)).error["rms_mm"]
    return hidden.measure(standard_protocol(2)), hidden.measure(judge, seed=1), floor
