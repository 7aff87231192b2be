"""The aircraft's end of the radio link: downlink, uplink, backfill, downloads, and what stock ground stations expect."""
