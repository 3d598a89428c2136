"""The data: experiments as a laboratory makes them, and what is done to them before they are observed."""
