"""Drive by hand: pictures, landmarks of a hand, keys, the enable key, and the page in a browser."""
