"""Signed datagrams between computers: sessions, frames of a camera and the points in them."""
