"""Types of the compiled core; the bindings in rust/python/ implement them."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

class CoreError(ValueError): ...
class NoEquilibriumError(CoreError): ...
