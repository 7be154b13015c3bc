"""Policies, and the rules that improve them (Fig. 1, step 7)."""
