"""Outside data with known answers: our answer compared with general methods (`make outside`)."""
