"""The paper's figures, tables and claims as pictures, files and a page."""
