"""The model of a joint fit."""

from estimation.models.base import Model, ParameterRole


def joint_model(model: Model) -> Model:
    """The model for a joint fit: constant coefficients (CY_0 Cl_0 Cn_0 ...) are each flight's own.

    They hold the trim, the centre of gravity and the sensor offsets of the day as much as the aircraft.
    """
    return model.with_local(*model.free_of(ParameterRole.CONSTANT))
