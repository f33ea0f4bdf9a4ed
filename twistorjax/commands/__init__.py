"""The commands of `twistorjax`, each with what it prints."""
