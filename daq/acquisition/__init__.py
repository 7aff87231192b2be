"""What makes a scan: sensors under supervision, their health, the attitude filter. Above `sensors`, below the logger."""
