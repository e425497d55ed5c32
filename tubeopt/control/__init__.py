"""In the loop at 1 kHz: a servo, its snap guard, an observer, and the ways in which a controller reaches them."""
