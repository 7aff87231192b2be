"""From the bytes of a link to scans with exact accounting: decoding, backfill and recording, without calibration."""
