"""Does any certificate exist, and if not, which mode or which schedule stands in the way?"""
