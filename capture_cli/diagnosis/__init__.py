"""What is still unexplained: noise floor, split, lack of fit."""
