"""The best model that records allow: candidates, tried within a budget, judged on folds."""
