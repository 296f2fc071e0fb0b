"""Compare our answers with general methods on outside data with known answers (`make outside`)."""
