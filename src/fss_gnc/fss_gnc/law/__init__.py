"""Control laws of users: their contract, their forms, and the process that a law runs in."""

from .contract import Inputs as Inputs
from .contract import Outputs as Outputs
