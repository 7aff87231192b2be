"""The preparation of a flight for estimation, one pipeline of named steps.

`stretches` (which part of a flight a call is about) -> `conditioned` (what is a measurement) -> `plausible` (units and signs) ->
`columns` (what can be made of others) -> `inputs` -> `pipeline`, which runs the steps and gives a `FlightData` for one model.
"""
