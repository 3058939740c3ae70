"""FMU files: what their modelDescription.xml says, and where they are unpacked."""
