"""One evaluation of identifiers, and the suite of all comparisons of the paper."""
