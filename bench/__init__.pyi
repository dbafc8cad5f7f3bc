"""The names that scripts and notebooks use."""

from .api import load as load
from .api import run as run
from .plan.suite import Suite as Suite
from .store.tables import Tables as Tables
