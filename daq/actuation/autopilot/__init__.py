"""Through an ArduPlane in between: RC_CHANNELS_OVERRIDE, and what it has to prove first (docs/sequencer.md)."""
