"""What Alembic runs: the versions, in the transaction of whoever opened the database."""

from alembic import context

context.configure(connection=context.config.attributes["connection"], transactional_ddl=True)
context.run_migrations()
