"""Does the experiment that a study asks for tell its tied explanations apart better than others of the same list?"""
