"""Report, pictures, rerun recording and pages of the documentation."""
