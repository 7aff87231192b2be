"""Postulated models: equations as text, parameters with units, and the ways to get one."""

from estimation.models.base import InputTransform, Model, Parameter, ParameterRole, Signal
from estimation.models.load import load_model, read_model, write_model

__all__ = ["InputTransform", "Model", "Parameter", "ParameterRole", "Signal", "load_model", "read_model", "write_model"]
