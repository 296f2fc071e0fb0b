"""Signed datagrams between computers: sessions, camera frames and their points."""
