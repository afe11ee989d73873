"""How histories are made: the recipe of one, where its actions come from, and where the work is done."""
