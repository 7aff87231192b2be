"""What goes up: commands, requests for what was lost, downloads, manoeuvres."""
