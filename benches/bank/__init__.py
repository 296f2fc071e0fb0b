"""The benchmark bank: hidden laws with their own formulas, and the score of a diagnosis.

The formulas are other than the library's.
"""
