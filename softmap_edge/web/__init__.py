"""Serve a page of this package to a browser: HTTP, WebSocket, and who may connect."""
