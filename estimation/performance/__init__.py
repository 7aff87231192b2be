"""Performance from flights whose thrust is known: drag polar, glide, sink, power required, with bounds."""
