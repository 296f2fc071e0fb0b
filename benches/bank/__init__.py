"""The benchmark bank: truths not written with the library's formulas, and how a diagnosis of them is judged."""
