"""Outside data with known answers: our answer beside what general methods reach (`make outside`)."""
