"""Programs that shade the common scene: jaxlight and its peers, each as a competent user of its library writes it."""
