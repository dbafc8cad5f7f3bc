"""The names that scripts and notebooks use."""

from .correction import corrected as corrected
from .engine import diagnose as diagnose
from .logs.flights import FlightSet as FlightSet
from .logs.flights import load_flights as load_flights
from .result import Diagnosis as Diagnosis
