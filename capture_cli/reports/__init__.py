"""What people look at: one record in; a page, figures and terminal tables out."""
