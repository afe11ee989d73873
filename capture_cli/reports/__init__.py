"""What people look at: one record in, an HTML page, figures and terminal tables out. Nothing is computed twice."""
