"""The benchmark bank: hidden laws with other formulas than the library's, and the score of a
diagnosis.
"""
