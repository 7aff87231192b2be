"""One estimation session: methods over flights, their scatter and joint fit, second looks, proof of match."""
