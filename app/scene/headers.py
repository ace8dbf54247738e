"""What the proxy tells a scene's server beside the traffic: that it may, and for which viewer."""

KEY_HEADER, VIEWER_HEADER = "x-scene-key", "x-scene-viewer"
