"""Check data: lost points, clocks, inseparable conditions, a run of another robot."""
