"""What people look at: one record in; a page, figures and terminal tables out. Nothing is decided here.

In: the document and the arrays of a result. Out: report.html by `templates`, PNG figures, tables at the terminal. What
is said of a record, in words and rows, has one source for all three (`findings`, `diagnosis_findings`).
"""
