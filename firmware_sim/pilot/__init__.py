"""Who moves the controls: manoeuvres and the simulated pilot."""
