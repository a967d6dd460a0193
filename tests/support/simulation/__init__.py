"""Components, systems and expectations for tests of the engine and what runs it."""
