"""The engine: a model traced once, integrated with its exact sensitivities, compiled where there is a compiler."""
