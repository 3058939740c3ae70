"""Tables as engineers have them: files and objects in, one table with names, units and remarks out."""
