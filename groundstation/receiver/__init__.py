"""From bytes of a link to scans that are accounted for: decode, order, backfill, record. Knows no calibration."""
