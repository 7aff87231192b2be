"""What the simulator can hide: physics the aircraft has and its model does not, each in a class of its own."""
