"""Model exchange: FMUs that give derivatives and events, and the solvers that make them components."""

from orchestrator.exchange.slave import ExchangeSlave
from orchestrator.exchange.solver import Method, SolverSettings

__all__ = ["ExchangeSlave", "Method", "SolverSettings"]
