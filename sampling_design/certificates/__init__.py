"""What a schedule proves: certificates of detectability from samples, exact and from the paper."""
