"""Maps of Nav2 (map_server): read, written, and turned into scenes."""
