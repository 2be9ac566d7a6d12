"""sincos and atan2 against mpmath, in units of the last place of the exact value."""

import numpy as np
import pytest
from oracle import mp
